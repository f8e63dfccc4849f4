//! Readings of an inertial sensor, in EuRoC's layout: `ns,wx,wy,wz,ax,ay,az` in rad/s and m/s², and
//! `T_BS` in a `sensor.yaml` beside it.

use std::fs;
use std::path::Path;

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
}

/// Reads a file of readings. Lines that are none are skipped and counted; a stamp that does not
/// increase is an error, since nobody knows which of them are wrong.
pub fn read_imu(path: &Path) -> Result<ImuReadings, FileError> {
    let text = read_text(path)?;
    let mounting = path.with_file_name("sensor.yaml");
    let body_from_sensor = if mounting.is_file() {
        let text = read_text(&mounting)?;
        parse_mounting(&text).map_err(|refused| refused.into_error(&mounting))?
    } else {
        Matrix3::identity()
    };
    parse(&text, &body_from_sensor).map_err(|refused| refused.into_error(path))
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
        return Err(Refused::whole(
            "no readings; expected lines of ns,wx,wy,wz,ax,ay,az",
        ));
    }
    Ok(found)
}

fn parse_line(line: &str, body_from_sensor: &Matrix3<f64>) -> Result<ImuReading, String> {
    let mut fields = line.split(',').map(str::trim);
    let stamp = fields.next().unwrap_or_default();
    let nanoseconds = stamp
        .parse()
        .map_err(|_| format!("expected a time in nanoseconds, got `{stamp}`"))?;
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
}
