//! Loops that drift in position, heading and scale, and derivatives against differences.

use geometry::{Transform, so3};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;

fn tangent(rng: &mut ChaCha8Rng, limit: f64) -> Tangent7 {
    Tangent7::from_fn(|_, _| rng.random_range(-limit..=limit))
}

/// A circle of radius five, once around.
fn circle(node_count: usize) -> Vec<Similarity<Map, Camera>> {
    (0..node_count)
        .map(|i| {
            let angle = std::f64::consts::TAU * i as f64 / node_count as f64;
            let place = Vector3::new(5.0 * angle.cos(), 0.0, 5.0 * angle.sin());
            let pose: Transform<Map, Camera> =
                Transform::new(so3::exp(&(Vector3::y() * -angle)), place);
            Similarity::from(pose)
        })
        .collect()
}

fn edge(
    truth: &[Similarity<Map, Camera>],
    first_idx: usize,
    second_idx: usize,
    error: &Tangent7,
) -> PoseEdge {
    PoseEdge {
        first_idx,
        second_idx,
        first_from_second: (truth[first_idx].inverse() * truth[second_idx]).perturbed(error),
        information: Matrix7::identity() * 100.0,
    }
}

/// Odometry with a systematic error and a correct loop edge; nodes start by dead reckoning.
fn drifting_loop(node_count: usize) -> (Vec<Similarity<Map, Camera>>, PoseGraph) {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let truth = circle(node_count);
    let mut graph = PoseGraph::default();
    graph.nodes.push(PoseNode {
        map_from_camera: truth[0],
        fixed: true,
    });
    for i in 1..node_count {
        let mut error = tangent(&mut rng, 0.002);
        error[1] += 0.5 / node_count as f64;
        error[6] += 0.3 / node_count as f64;
        let odometry = edge(&truth, i - 1, i, &error);
        let last = graph.nodes[i - 1].map_from_camera;
        graph.nodes.push(PoseNode {
            map_from_camera: last * odometry.first_from_second,
            fixed: false,
        });
        graph.edges.push(odometry);
    }
    graph
        .edges
        .push(edge(&truth, node_count - 1, 0, &Tangent7::zeros()));
    (truth, graph)
}

/// Distance of the positions, root mean square.
fn position_error(graph: &PoseGraph, truth: &[Similarity<Map, Camera>]) -> f64 {
    let squared: f64 = graph
        .nodes
        .iter()
        .zip(truth)
        .map(|(node, truth)| {
            (node.map_from_camera.translation() - truth.translation()).norm_squared()
        })
        .sum();
    (squared / truth.len() as f64).sqrt()
}

#[test]
fn edge_jacobians_match_differences() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for _ in 0..20 {
        let truth = circle(5);
        let mut nodes: Vec<PoseNode> = truth
            .iter()
            .map(|pose| PoseNode {
                map_from_camera: pose.perturbed(&tangent(&mut rng, 0.3)),
                fixed: false,
            })
            .collect();
        let edge = edge(&truth, 1, 3, &tangent(&mut rng, 0.3));
        let jacobians = d_residual_d_nodes(&edge, &nodes, &residual(&edge, &nodes));
        for (node_idx, jacobian) in [1, 3].into_iter().zip(jacobians) {
            let start = nodes[node_idx].map_from_camera;
            for axis in 0..7 {
                let mut value = |width: f64| {
                    let mut delta = Tangent7::zeros();
                    delta[axis] = width;
                    nodes[node_idx].map_from_camera = start.perturbed(&delta);
                    residual(&edge, &nodes)
                };
                let numeric = (value(1e-6) - value(-1e-6)) / 2e-6;
                nodes[node_idx].map_from_camera = start;
                let difference = (numeric - jacobian.column(axis)).norm();
                assert!(
                    difference < 1e-4,
                    "node {node_idx}, axis {axis}: {difference}"
                );
            }
        }
    }
}

#[test]
fn a_closed_loop_takes_most_of_the_drift_away() {
    let (truth, mut graph) = drifting_loop(60);
    let before = position_error(&graph, &truth);
    let report = optimise(&mut graph, &PoseGraphSettings::default());
    let after = position_error(&graph, &truth);
    assert!(
        report.converged && report.cost_after < 0.1 * report.cost_before,
        "{report:?}"
    );
    assert!(after < 0.3 * before, "{before} {after}");
    assert_eq!(graph.nodes[0].map_from_camera, truth[0]);
}

#[test]
fn consistent_edges_leave_no_cost() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let truth = circle(30);
    let mut graph = PoseGraph::default();
    for (i, pose) in truth.iter().enumerate() {
        let error = tangent(&mut rng, if i == 0 { 0.0 } else { 0.1 });
        graph.nodes.push(PoseNode {
            map_from_camera: pose.perturbed(&error),
            fixed: i == 0,
        });
        for other in [i + 1, i + 2, i + 7] {
            graph
                .edges
                .push(edge(&truth, i, other % 30, &Tangent7::zeros()));
        }
    }
    let report = optimise(&mut graph, &PoseGraphSettings::default());
    assert!(report.cost_after < 1e-9, "{report:?}");
    assert!(position_error(&graph, &truth) < 1e-5);
}

#[test]
fn a_false_loop_is_outvoted_under_a_kernel() {
    let (truth, mut graph) = drifting_loop(40);
    optimise(&mut graph, &PoseGraphSettings::default());
    for i in 0..38 {
        graph.edges.push(edge(&truth, i, i + 2, &Tangent7::zeros()));
    }
    let mut wrong = Tangent7::zeros();
    wrong[3] = 3.0;
    graph.edges.push(edge(&truth, 10, 30, &wrong));
    let settings = PoseGraphSettings {
        kernel: RobustKernel::GemanMcClure { threshold: 1.0 },
        ..PoseGraphSettings::default()
    };
    optimise(&mut graph, &settings);
    assert!(
        position_error(&graph, &truth) < 0.3,
        "{}",
        position_error(&graph, &truth)
    );
}

#[test]
fn senseless_edges_are_left_out() {
    let (_, mut graph) = drifting_loop(10);
    let good = graph.edges[0];
    graph.edges.push(PoseEdge {
        first_idx: 99,
        ..good
    });
    graph.edges.push(PoseEdge {
        second_idx: good.first_idx,
        ..good
    });
    graph.edges.push(PoseEdge {
        information: Matrix7::repeat(f64::NAN),
        ..good
    });
    let report = optimise(&mut graph, &PoseGraphSettings::default());
    assert_eq!(report.ignored_edge_count, 3);
    assert!(report.cost_after.is_finite());
    let empty = optimise(&mut PoseGraph::default(), &PoseGraphSettings::default());
    assert!(empty.converged);
}

#[test]
fn hundreds_of_nodes_are_no_problem() {
    let (truth, mut graph) = drifting_loop(400);
    let report = optimise(&mut graph, &PoseGraphSettings::default());
    assert!(report.converged, "{report:?}");
    assert!(position_error(&graph, &truth) < 0.5);
}
