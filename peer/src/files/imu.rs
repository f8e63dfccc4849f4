//! Readings of an inertial sensor, in EuRoC's layout: `ns,wx,wy,wz,ax,ay,az` in rad/s and m/s², and
//! `T_BS` in a `sensor.yaml` beside it.

use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};

use geometry::Timestamp;
use nalgebra::{Matrix3, Vector3};

use super::error::{FileError, Refused};

/// One line, in the axes of the vehicle's body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuReading {
    /// Taken to be of the camera's clock: an offset between the two is not estimated.
    pub captured_at: Timestamp,
    pub rate_in_body: Vector3<f64>,
    pub specific_force_in_body: Vector3<f64>,
}

/// What a file holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ImuReadings {
    /// Their stamps increase.
    pub readings: Vec<ImuReading>,
    pub skipped_count: usize,
    /// Line and reason of the first that is none.
    pub first_skipped: Option<(usize, String)>,
    /// What is odd about all of them, a sentence each.
    pub doubts: Vec<String>,
}

/// Faster than any vehicle whose camera sees something turns, and than what most gyroscopes can
/// measure: 2000°/s (rad/s).
const RATE_MAX: f64 = 35.0;
/// Some of them may be errors of the sensor.
const FAST_SHARE_MAX: f64 = 0.01;
/// Between two readings: no inertial sensor is faster than 50 kHz (s).
const INTERVAL_S_MIN: f64 = 2e-5;
/// Over longer intervals turns are not followed: see `vslam` (s).
const INTERVAL_S_MAX: f64 = 0.05;
/// What an accelerometer feels most of the time, whatever a vehicle does (m/s²).
const FORCE: Range<f64> = 5.0..15.0;

/// Reads a file of readings. Lines that are none are skipped and counted; a stamp that does not
/// increase is an error, since nobody knows which of them are wrong.
pub fn read_imu(path: &Path) -> Result<ImuReadings, FileError> {
    let text = read_text(path)?;
    let mounting = imu_mounting(path);
    let body_from_sensor = if mounting.is_file() {
        let text = read_text(&mounting)?;
        parse_mounting(&text).map_err(|refused| refused.into_error(&mounting))?
    } else {
        Matrix3::identity()
    };
    let mut found = parse(&text, &body_from_sensor).map_err(|refused| refused.into_error(path))?;
    found.check().map_err(|refused| refused.into_error(path))?;
    Ok(found)
}

impl ImuReadings {
    /// Refuses what cannot be in the units that are expected, and notes what is odd.
    fn check(&mut self) -> Result<(), Refused> {
        let stamps = self.readings.iter().map(|one| one.captured_at);
        let intervals = stamps.clone().zip(stamps.skip(1));
        if let Some(interval_s) = median(intervals.map(|(earlier, later)| later - earlier)) {
            if interval_s < INTERVAL_S_MIN {
                return Err(Refused::whole(format!(
                    "by their stamps the readings are {:.3} µs apart, faster than any sensor; \
                     expected nanoseconds, and these look like another unit (of microseconds, \
                     multiply by 1000)",
                    interval_s * 1e6
                )));
            }
            if interval_s > INTERVAL_S_MAX {
                self.doubts.push(format!(
                    "the readings are {interval_s:.3} s apart: turns are followed only with more \
                     than {:.0} a second",
                    INTERVAL_S_MAX.recip()
                ));
            }
        }
        let rates = self.readings.iter().map(|one| one.rate_in_body.norm());
        let forces = self.readings.iter();
        let force = median(forces.map(|one| one.specific_force_in_body.norm())).unwrap_or(0.0);
        if FORCE.contains(&median(rates.clone()).unwrap_or(0.0)) && force < FORCE.start {
            return Err(Refused::whole(
                "the gyroscope tells what an accelerometer does, and the other way: expected \
                 columns ns,wx,wy,wz,ax,ay,az in rad/s and m/s², and not degrees per second with g",
            ));
        }
        let fast_count = rates.clone().filter(|rate| *rate > RATE_MAX).count();
        if fast_count as f64 > FAST_SHARE_MAX * self.readings.len() as f64 {
            return Err(Refused::whole(format!(
                "{fast_count} of {} readings tell turns faster than {RATE_MAX} rad/s, up to {:.0}: \
                 they look like degrees per second; multiply them by π/180",
                self.readings.len(),
                rates.fold(0.0, f64::max)
            )));
        }
        if !FORCE.contains(&force) {
            let unit = if (0.5..1.5).contains(&force) {
                " (it looks like g: multiply by 9.81)"
            } else {
                ""
            };
            self.doubts.push(format!(
                "the accelerometer tells {force:.2} m/s² most of the time, expected about \
                 9.8{unit}: where up is will not be known"
            ));
        }
        Ok(())
    }
}

fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

/// Where the axes of a file's sensor are told, if they are.
pub fn imu_mounting(path: &Path) -> PathBuf {
    path.with_file_name("sensor.yaml")
}

fn read_text(path: &Path) -> Result<String, FileError> {
    fs::read_to_string(path).map_err(|error| FileError::Read {
        error,
        path: path.to_owned(),
    })
}

fn parse(text: &str, body_from_sensor: &Matrix3<f64>) -> Result<ImuReadings, Refused> {
    let mut found = ImuReadings::default();
    for (line_idx, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        match parse_line(line, body_from_sensor) {
            Ok(reading) => {
                let last = found.readings.last();
                if last.is_some_and(|last| reading.captured_at <= last.captured_at) {
                    let reason = "the time stamp does not increase";
                    return Err(Refused::at(line_idx + 1, reason));
                }
                found.readings.push(reading);
            }
            Err(reason) => {
                found.skipped_count += 1;
                found.first_skipped.get_or_insert((line_idx + 1, reason));
            }
        }
    }
    if found.readings.is_empty() {
        let expected = "no readings; expected lines of ns,wx,wy,wz,ax,ay,az";
        return Err(match found.first_skipped {
            None => Refused::whole(expected),
            Some((line, reason)) => Refused::at(line, format!("{expected}; {reason}")),
        });
    }
    Ok(found)
}

fn parse_line(line: &str, body_from_sensor: &Matrix3<f64>) -> Result<ImuReading, String> {
    let mut fields = line.split(',').map(str::trim);
    let stamp = fields.next().unwrap_or_default();
    let nanoseconds = stamp.parse().map_err(|_| {
        let hint = match stamp.parse::<f64>() {
            Ok(_) => " (of seconds, multiply by 10⁹ and leave no fraction)",
            Err(_) => "",
        };
        format!("expected a time in whole nanoseconds, got `{stamp}`{hint}")
    })?;
    let mut numbers = [0.0_f64; 6];
    for number in &mut numbers {
        let field = fields.next().ok_or("expected seven fields")?;
        let parsed = field.parse().ok().filter(|value: &f64| value.is_finite());
        *number = parsed.ok_or_else(|| format!("expected a number, got `{field}`"))?;
    }
    let [wx, wy, wz, ax, ay, az] = numbers;
    Ok(ImuReading {
        captured_at: Timestamp::from_nanoseconds(nanoseconds),
        rate_in_body: body_from_sensor * Vector3::new(wx, wy, wz),
        specific_force_in_body: body_from_sensor * Vector3::new(ax, ay, az),
    })
}

/// The axes of `T_BS`; the lever between sensor and body does not matter for turns.
fn parse_mounting(text: &str) -> Result<Matrix3<f64>, Refused> {
    let Some((_, after)) = text.split_once("T_BS") else {
        return Ok(Matrix3::identity());
    };
    let numbers: Option<Vec<f64>> = after
        .split_once("data:")
        .and_then(|(_, rest)| rest.split_once('['))
        .and_then(|(_, rest)| rest.split_once(']'))
        .and_then(|(list, _)| list.split(',').map(|one| one.trim().parse().ok()).collect());
    let Some([a, b, c, _, d, e, f, _, g, h, i, _, _, _, _, _]) = numbers.as_deref() else {
        return Err(Refused::whole("T_BS has no data of 16 numbers"));
    };
    let rotation = Matrix3::new(*a, *b, *c, *d, *e, *f, *g, *h, *i);
    let error = (rotation * rotation.transpose() - Matrix3::identity()).norm();
    // A comparison with NaN is false.
    if error < 1e-2 && rotation.determinant() > 0.0 {
        Ok(rotation)
    } else {
        Err(Refused::whole("T_BS is not a rigid transform"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str = "#timestamp [ns],w_RS_S_x [rad s^-1],…\r\n";

    #[test]
    fn lines_are_read_and_bad_ones_counted() {
        let text = format!(
            "{HEADER}100,0.1,0.2,0.3,9.8,0,0\r\n\n200,nan,0,0,0,0,0\n300,1,2\nx,1,2,3,4,5,6\n\
             400,1,2,3,4,5,6,surplus\n"
        );
        let found = parse(&text, &Matrix3::identity()).unwrap();
        assert_eq!(found.readings.len(), 2);
        assert_eq!(found.readings[0].rate_in_body, Vector3::new(0.1, 0.2, 0.3));
        assert_eq!(
            found.readings[1].captured_at,
            Timestamp::from_nanoseconds(400)
        );
        assert_eq!(found.skipped_count, 3);
        let (line, reason) = found.first_skipped.unwrap();
        assert_eq!((line, reason.as_str()), (4, "expected a number, got `nan`"));
    }

    #[test]
    fn stamps_that_do_not_increase_are_refused_with_their_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("data.csv");
        let refusal = |text: &str| {
            fs::write(&path, text).unwrap();
            read_imu(&path).unwrap_err().to_string()
        };
        let message = refusal("100,0,0,0,0,0,0\n200,0,0,0,0,0,0\n200,0,0,0,0,0,0\n");
        assert!(
            message.starts_with("the time stamp does not increase at"),
            "{message}"
        );
        assert!(message.ends_with("data.csv:3"), "{message}");
        let message = refusal(HEADER);
        assert!(message.starts_with("no readings; expected"), "{message}");
    }

    #[test]
    fn readings_are_turned_into_the_body() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("data.csv");
        fs::write(&path, "100,1,2,3,4,5,6\n").unwrap();
        let mounted = |data: &str| {
            let text =
                format!("sensor_type: imu\nT_BS:\n  rows: 4\n  data: [{data}]\nrate_hz: 200");
            fs::write(folder.path().join("sensor.yaml"), text).unwrap();
            read_imu(&path)
        };
        let found = mounted("0, -1, 0, 5,\n 1, 0, 0, 6,\n 0, 0, 1, 7,\n 0, 0, 0, 1").unwrap();
        assert_eq!(found.readings[0].rate_in_body, Vector3::new(-2.0, 1.0, 3.0));
        for (data, expected) in [
            ("1, 2, 3", "T_BS has no data of 16 numbers"),
            (
                "2,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1",
                "T_BS is not a rigid transform",
            ),
        ] {
            let message = mounted(data).unwrap_err().to_string();
            assert!(message.starts_with(expected), "{message}");
            assert!(message.ends_with("sensor.yaml"), "{message}");
        }
    }

    /// Readings of a hand that carries a camera about, 200 a second.
    fn carried(write: impl Fn(i64, [f64; 3], [f64; 3]) -> String) -> String {
        let line = |idx: i64| {
            let phase = idx as f64 * 0.02;
            let rate = [phase.sin(), 0.7 * phase.cos(), 0.2].map(|rate| 1.5 * rate);
            write(idx * 5_000_000, rate, [0.3 * phase.sin(), 0.1, 9.8])
        };
        (0..1000).map(line).collect()
    }

    fn line(nanoseconds: i64, [wx, wy, wz]: [f64; 3], [ax, ay, az]: [f64; 3]) -> String {
        format!("{nanoseconds},{wx},{wy},{wz},{ax},{ay},{az}\n")
    }

    #[test]
    fn units_that_are_not_those_that_are_expected_are_told() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("data.csv");
        let read = |text: String| {
            fs::write(&path, text).unwrap();
            read_imu(&path)
        };
        let refused = |text: String, expected: &str| {
            let error = read(text).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        };
        let doubts = |text: String| read(text).unwrap().doubts;
        assert_eq!(doubts(carried(line)), Vec::<String>::new());
        let degrees = |at, rate: [f64; 3], force| line(at, rate.map(f64::to_degrees), force);
        refused(carried(degrees), "they look like degrees per second");
        let swapped = |at, rate, force| line(at, force, rate);
        refused(carried(swapped), "expected columns ns,wx,wy,wz,ax,ay,az");
        let microseconds = |at: i64, rate, force| line(at / 1000, rate, force);
        refused(carried(microseconds), "of microseconds, multiply by 1000");
        let seconds = |at: i64, rate, force| {
            let text = line(at, rate, force);
            let (_, rest) = text.split_once(',').unwrap();
            format!("{:.6},{rest}", at as f64 * 1e-9)
        };
        refused(carried(seconds), "of seconds, multiply by 10⁹");
        let in_g = |at, rate, force: [f64; 3]| line(at, rate, force.map(|one| one / 9.81));
        let told = doubts(carried(in_g));
        assert!(
            told.len() == 1 && told[0].contains("it looks like g"),
            "{told:?}"
        );
        let slow = |at: i64, rate, force| line(at * 20, rate, force);
        let told = doubts(carried(slow));
        assert!(
            told[0].starts_with("the readings are 0.100 s apart"),
            "{told:?}"
        );
        // A few errors of the sensor are no unit.
        let spike = |at: i64, rate: [f64; 3], force| {
            let is_spike = at % 500_000_000 == 0;
            line(at, rate.map(|one| if is_spike { 60.0 } else { one }), force)
        };
        assert_eq!(doubts(carried(spike)), Vec::<String>::new());
    }
}
