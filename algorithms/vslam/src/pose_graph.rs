//! Sim(3) pose graph: spreads what a closed loop says over the keyframes in between.
//!
//! A monocular map drifts in scale as well, so nodes and edges are similarities (Strasdat 2012).

use geometry::{Camera, Map, Matrix7, RobustKernel, Similarity, Tangent7};
use nalgebra::Matrix3;

use crate::block_cholesky::BlockEnvelope;

#[cfg(test)]
mod tests;

/// A keyframe in the graph.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseNode {
    /// Its pose with the scale that its surroundings have in the map: one before the loop.
    /// Steps perturb it on the right, `map_from_camera * exp([ω; ν; ln s])`.
    pub map_from_camera: Similarity<Map, Camera>,
    /// Whether it stays as it is. At least one should; a graph without any floats.
    pub fixed: bool,
}

/// What is known of the relation between two nodes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseEdge {
    /// Which of [`PoseGraph::nodes`].
    pub first_idx: usize,
    /// Which of [`PoseGraph::nodes`]; not the first.
    pub second_idx: usize,
    /// The measured relation, in the scale of each.
    pub first_from_second: Similarity<Camera, Camera>,
    /// Inverse covariance of its `[ω; ν; ln s]`, perturbed on the right. The identity, times how
    /// many points the two share, is the usual choice.
    pub information: Matrix7,
}

/// Nodes and edges; [`optimise`] overwrites the nodes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PoseGraph {
    /// Best in the order of time: the solver uses that most edges join neighbours.
    pub nodes: Vec<PoseNode>,
    /// In any order. Edges that are not finite or whose indices are out of range are left out.
    pub edges: Vec<PoseEdge>,
}

/// How long to optimise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseGraphSettings {
    /// Steps at most.
    pub iteration_count_max: usize,
    /// Stop when a step lowers the cost by less than this share of it.
    pub cost_decrease_min: f64,
    /// How the squared, whitened residual of an edge counts. A kernel lets good edges outvote a
    /// false loop.
    pub kernel: RobustKernel,
}

impl Default for PoseGraphSettings {
    fn default() -> Self {
        Self {
            iteration_count_max: 30,
            cost_decrease_min: 1e-6,
            kernel: RobustKernel::None,
        }
    }
}

/// What [`optimise`] did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseGraphReport {
    /// Robust cost before.
    pub cost_before: f64,
    /// Robust cost after.
    pub cost_after: f64,
    /// Steps tried, refused ones included.
    pub iteration_count: usize,
    /// Whether the last step gained too little to go on.
    pub converged: bool,
    /// Edges that were left out because they make no sense.
    pub ignored_edge_count: usize,
}

/// Moves the free nodes to where the edges fit best.
///
/// Levenberg–Marquardt with a block Cholesky factorisation inside the envelope. Deterministic.
/// Cost per step: nodes × (edges that leap over each)² block products; a few milliseconds for a
/// hundred nodes and one loop.
pub fn optimise(graph: &mut PoseGraph, settings: &PoseGraphSettings) -> PoseGraphReport {
    let mut solver = Solver::new(graph, settings.kernel);
    let mut cost = solver.cost(&graph.nodes);
    let mut report = PoseGraphReport {
        cost_before: cost,
        cost_after: cost,
        iteration_count: 0,
        converged: false,
        ignored_edge_count: graph.edges.len() - solver.edges.len(),
    };
    let mut damping = 1e-6;
    while report.iteration_count < settings.iteration_count_max && !report.converged {
        report.iteration_count += 1;
        let Some(moved) = solver.step(&graph.nodes, damping) else {
            damping *= 10.0;
            continue;
        };
        let moved_cost = solver.cost(&moved);
        if moved_cost <= cost {
            // Also where nothing is left to gain.
            report.converged = cost - moved_cost <= settings.cost_decrease_min * cost;
            graph.nodes = moved;
            cost = moved_cost;
            damping = (0.1 * damping).max(1e-12);
        } else {
            damping *= 10.0;
            report.converged = damping > DAMPING_MAX;
        }
    }
    report.cost_after = cost;
    report
}

/// With more damping than this a step moves nothing.
const DAMPING_MAX: f64 = 1e8;

struct Solver {
    edges: Vec<PoseEdge>,
    kernel: RobustKernel,
    /// For each node its row, if it is free.
    rows: Vec<Option<usize>>,
    system: BlockEnvelope<7>,
    steps: Vec<Tangent7>,
}

impl Solver {
    fn new(graph: &PoseGraph, kernel: RobustKernel) -> Self {
        let makes_sense = |edge: &&PoseEdge| {
            edge.first_idx != edge.second_idx
                && edge.first_idx.max(edge.second_idx) < graph.nodes.len()
                && edge
                    .first_from_second
                    .to_matrix()
                    .iter()
                    .all(|e| e.is_finite())
                && edge.information.iter().all(|e| e.is_finite())
        };
        let edges: Vec<PoseEdge> = graph.edges.iter().filter(makes_sense).copied().collect();
        let mut rows = Vec::with_capacity(graph.nodes.len());
        let mut row_count = 0;
        for node in &graph.nodes {
            rows.push((!node.fixed).then_some(row_count));
            row_count += usize::from(!node.fixed);
        }
        let mut first_columns: Vec<usize> = (0..row_count).collect();
        for edge in &edges {
            if let (Some(first), Some(second)) = (rows[edge.first_idx], rows[edge.second_idx]) {
                let (low, high) = (first.min(second), first.max(second));
                first_columns[high] = first_columns[high].min(low);
            }
        }
        let mut system = BlockEnvelope::default();
        system.reshape(first_columns.into_iter());
        Self {
            edges,
            kernel,
            rows,
            system,
            steps: vec![Tangent7::zeros(); row_count],
        }
    }

    fn cost(&self, nodes: &[PoseNode]) -> f64 {
        let squared = |edge: &PoseEdge| {
            let residual = residual(edge, nodes);
            residual.dot(&(edge.information * residual))
        };
        self.edges
            .iter()
            .map(|edge| self.kernel.cost(squared(edge)))
            .sum()
    }

    /// The nodes after one damped Gauss–Newton step.
    fn step(&mut self, nodes: &[PoseNode], damping: f64) -> Option<Vec<PoseNode>> {
        self.linearise(nodes);
        for row in 0..self.steps.len() {
            let block = self.system.block_mut(row, row);
            for axis in 0..7 {
                block[(axis, axis)] += damping * block[(axis, axis)].max(DIAGONAL_MIN);
            }
        }
        self.system.factorise().ok()?;
        self.system.solve(&mut self.steps);
        let finite = self
            .steps
            .iter()
            .all(|step| step.iter().all(|entry| entry.is_finite()));
        // A scale that changes by e² in one step is no step but an escape.
        let bounded = self.steps.iter().all(|step| step[6].abs() < 2.0);
        (finite && bounded).then(|| self.moved(nodes))
    }

    fn moved(&self, nodes: &[PoseNode]) -> Vec<PoseNode> {
        let mut moved = nodes.to_vec();
        for (node, row) in moved.iter_mut().zip(&self.rows) {
            if let Some(row) = row {
                node.map_from_camera = node.map_from_camera.perturbed(&self.steps[*row]);
            }
        }
        moved
    }

    /// Fills the system with `Jᵀ Λ J` and the steps with `−Jᵀ Λ r`.
    fn linearise(&mut self, nodes: &[PoseNode]) {
        self.system.set_zero();
        self.steps.fill(Tangent7::zeros());
        for edge in &self.edges {
            let residual = residual(edge, nodes);
            let squared = residual.dot(&(edge.information * residual));
            let weighted = edge.information * self.kernel.weight(squared);
            let jacobians = d_residual_d_nodes(edge, nodes, &residual);
            let rows = [self.rows[edge.first_idx], self.rows[edge.second_idx]];
            for (row, jacobian) in rows.into_iter().zip(&jacobians) {
                let Some(row) = row else { continue };
                let projected = jacobian.tr_mul(&weighted);
                self.steps[row] -= projected * residual;
                for (column, other) in rows.into_iter().zip(&jacobians) {
                    if let Some(column) = column.filter(|column| *column <= row) {
                        *self.system.block_mut(row, column) += projected * other;
                    }
                }
            }
        }
    }
}

/// Keeps a node without edges where it is.
const DIAGONAL_MIN: f64 = 1e-9;

/// `log(second_from_first_measured · map_from_first⁻¹ · map_from_second)`.
fn residual(edge: &PoseEdge, nodes: &[PoseNode]) -> Tangent7 {
    let first_from_second =
        nodes[edge.first_idx].map_from_camera.inverse() * nodes[edge.second_idx].map_from_camera;
    (edge.first_from_second.inverse() * first_from_second).log()
}

/// The derivatives by the first node's and the second node's right perturbation.
fn d_residual_d_nodes(edge: &PoseEdge, nodes: &[PoseNode], residual: &Tangent7) -> [Matrix7; 2] {
    let second_from_first =
        nodes[edge.second_idx].map_from_camera.inverse() * nodes[edge.first_idx].map_from_camera;
    let by_second = right_jacobian_inverse(residual);
    [-by_second * second_from_first.adjoint(), by_second]
}

/// `log(exp(ξ) exp(δ)) ≈ ξ + J δ`: the Bernoulli series in `ad ξ`, good to 1e-6 for `|ξ| < 1.5`.
fn right_jacobian_inverse(tangent: &Tangent7) -> Matrix7 {
    let ad = lie_bracket(tangent);
    let squared = ad * ad;
    let fourth = squared * squared;
    Matrix7::identity() + ad * 0.5 + squared / 12.0 - fourth / 720.0 + fourth * squared / 30240.0
        - fourth * fourth / 1_209_600.0
}

/// `ad ξ`, the derivative of the adjoint of `exp(ξ)` at the identity.
fn lie_bracket(tangent: &Tangent7) -> Matrix7 {
    let omega_hat = tangent.fixed_rows::<3>(0).into_owned().cross_matrix();
    let nu = tangent.fixed_rows::<3>(3).into_owned();
    let mut ad = Matrix7::zeros();
    ad.fixed_view_mut::<3, 3>(0, 0).copy_from(&omega_hat);
    ad.fixed_view_mut::<3, 3>(3, 0)
        .copy_from(&nu.cross_matrix());
    let turned = omega_hat + Matrix3::identity() * tangent[6];
    ad.fixed_view_mut::<3, 3>(3, 3).copy_from(&turned);
    ad.fixed_view_mut::<3, 1>(3, 6).copy_from(&-nu);
    ad
}
