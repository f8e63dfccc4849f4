//! What is flown: the rule, the swarm, its senses, and every number that can be set by name.

use keeping::{HeadingRule, KeeperSettings, PaperRuleSettings};
use sim::swarm::{LightBaseline, PictureSettings, SensingSettings, SwarmSettings};

/// Which rule the drones follow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RuleName {
    /// The paper's, as written.
    Paper,
    /// The first shell of neighbours, with the safety filter.
    Gabriel,
}

/// How good the drones' senses are, before single numbers are set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SensingName {
    /// No error and no delay, and drones that follow their commands at once.
    Ideal,
    /// Lag 0.3 s, latency 0.2 s, 0.3 px, 10 % missed, lights that merge, bodies that hide.
    Realistic,
    /// Rendered pictures of seven cameras, lag 0.3 s, latency 0.2 s.
    Rendered,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Scenario {
    pub rule: RuleName,
    pub swarm: SwarmSettings,
    pub paper: PaperRuleSettings,
    pub keeper: KeeperSettings,
    /// Drones see pictures.
    pub pictures: Option<PictureSettings>,
    pub duration_s: f64,
}

/// More drones than this take too long to render.
const PICTURED_COUNT_MAX: usize = 20;

/// Why a number could not be set.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum SettingError {
    #[error("expected NAME=VALUE, got {text:?}")]
    Form { text: String },
    #[error("there is no setting {name:?}; there are {known}")]
    Name { name: String, known: String },
    #[error("{name} takes {expected}, got {value:?}")]
    Value {
        name: &'static str,
        expected: &'static str,
        value: String,
    },
    #[error("drones in pictures carry all-round lights; leave marker_baseline out")]
    PicturedBaseline,
    #[error("pictures are rendered for at most {PICTURED_COUNT_MAX} drones, got {drone_count}")]
    PicturedCount { drone_count: usize },
    #[error("{name} is a setting of rendered pictures only: --sensing rendered")]
    NotPictured { name: &'static str },
}

impl Scenario {
    pub fn new(rule: RuleName, sensing: SensingName) -> Self {
        let mut scenario = Self {
            rule,
            swarm: SwarmSettings::default(),
            paper: PaperRuleSettings::default(),
            keeper: KeeperSettings::default(),
            pictures: None,
            duration_s: 120.0,
        };
        if sensing != SensingName::Ideal {
            scenario.swarm.lag_s = 0.3;
        }
        scenario.swarm.sensing = match sensing {
            SensingName::Ideal => SensingSettings::default(),
            SensingName::Realistic => SensingSettings {
                latency_s: 0.2,
                noise_px: 0.3,
                missed: 0.1,
                separation_px_min: 2.0,
                occlusion: true,
                bright_m: 14.0,
                ..SensingSettings::default()
            },
            SensingName::Rendered => SensingSettings {
                latency_s: 0.2,
                // Wider lenses than the paper's, and lights as much farther apart.
                light_distance_m: 0.15,
                occlusion: true,
                bright_m: 11.0,
                ..SensingSettings::default()
            },
        };
        if sensing == SensingName::Rendered {
            scenario.pictures = Some(PictureSettings::default());
        }
        scenario
    }

    /// Whether all that was set goes together.
    pub fn check(&self) -> Result<(), SettingError> {
        let drone_count = self.swarm.drone_count;
        if self.pictures.is_none() {
            return Ok(());
        }
        if self.swarm.sensing.baseline != LightBaseline::AllRound {
            return Err(SettingError::PicturedBaseline);
        }
        if drone_count > PICTURED_COUNT_MAX {
            return Err(SettingError::PicturedCount { drone_count });
        }
        Ok(())
    }

    /// Sets one number by name: `latency_s=0.5`.
    pub fn set(&mut self, text: &str) -> Result<(), SettingError> {
        let (name, value) = text.split_once('=').ok_or_else(|| SettingError::Form {
            text: text.to_owned(),
        })?;
        let known = || {
            let names: Vec<&str> = settings().map(|setting| setting.name).collect();
            names.join(", ")
        };
        let setting = settings()
            .find(|setting| setting.name == name)
            .ok_or_else(|| SettingError::Name {
                name: name.to_owned(),
                known: known(),
            })?;
        if self.pictures.is_none() && PICTURED.iter().any(|pictured| pictured.name == name) {
            return Err(SettingError::NotPictured { name: setting.name });
        }
        (setting.apply)(self, value).ok_or_else(|| SettingError::Value {
            name: setting.name,
            expected: setting.expected,
            value: value.to_owned(),
        })
    }
}

/// One name of `--set`.
struct Setting {
    name: &'static str,
    expected: &'static str,
    apply: fn(&mut Scenario, &str) -> Option<()>,
}

/// A number from `low` on, and below or at `high`.
fn number(text: &str, low: f64, high: f64) -> Option<f64> {
    text.parse()
        .ok()
        .filter(|value: &f64| (low..=high).contains(value))
}

macro_rules! numbers {
    ($($name:literal, $expected:literal, $low:literal..=$high:literal,
       |$scenario:ident, $value:ident| $body:expr;)*) => {
        [$(Setting {
            name: $name,
            expected: $expected,
            apply: |$scenario, text| {
                let $value = number(text, $low, $high)?;
                $body;
                Some(())
            },
        }),*]
    };
}

const NUMBERS: [Setting; 31] = numbers! {
    "duration_s", "10 to 3600 s", 10.0..=3600.0, |s, v| s.duration_s = v;
    "latency_s", "0 to 5 s", 0.0..=5.0, |s, v| s.swarm.sensing.latency_s = v;
    "lag_s", "0 to 5 s", 0.0..=5.0, |s, v| s.swarm.lag_s = v;
    "noise_px", "0 to 10 px", 0.0..=10.0, |s, v| s.swarm.sensing.noise_px = v;
    "missed", "a share from 0 to 1", 0.0..=1.0, |s, v| s.swarm.sensing.missed = v;
    "false_lights", "0 to 1 a frame", 0.0..=1.0, |s, v| s.swarm.sensing.false_lights = v;
    "elevation_deg", "5 to 90 degrees", 5.0..=90.0,
        |s, v| s.swarm.sensing.elevation_rad_max = v.to_radians();
    "azimuth_deg", "5 to 180 degrees", 5.0..=180.0,
        |s, v| s.swarm.sensing.azimuth_rad_max = v.to_radians();
    "visible_m", "1 to 100 m", 1.0..=100.0, |s, v| {
        s.swarm.sensing.visible_m = v;
        s.swarm.sensing.bright_m = s.swarm.sensing.bright_m.max(v);
        s.paper.visible_m = v;
    };
    "separation_px_min", "0 to 20 px", 0.0..=20.0,
        |s, v| s.swarm.sensing.separation_px_min = v;
    "occlusion", "0 or 1", 0.0..=1.0, |s, v| s.swarm.sensing.occlusion = v > 0.5;
    "blinded", "a number of drones", 0.0..=1000.0,
        |s, v| s.swarm.sensing.blinded = v as usize;
    "blinded_s", "0 to 3600 s", 0.0..=3600.0, |s, v| s.swarm.sensing.blinded_s = v;
    "unlit", "a number of drones", 0.0..=1000.0, |s, v| s.swarm.sensing.unlit = v as usize;
    "unlit_known", "0 or 1", 0.0..=1.0, |s, v| s.swarm.sensing.unlit_known = v > 0.5;
    "excess_mps_max", "0.1 to 10 m/s", 0.1..=10.0, |s, v| s.keeper.safety.excess_mps_max = v;
    "dropped", "a number of drones", 0.0..=1000.0, |s, v| s.swarm.dropped = v as usize;
    "light_distance_m", "0.01 to 1 m", 0.01..=1.0,
        |s, v| s.swarm.sensing.light_distance_m = v;
    "wind_mps", "0 to 5 m/s", 0.0..=5.0, |s, v| s.swarm.wind_mps = v;
    "heading_spread_deg", "0 to 90 degrees", 0.0..=90.0, |s, v| {
        s.swarm.heading_spread_rad = v.to_radians();
        // A common heading has to emerge.
        s.keeper.heading = if v > 0.0 { HeadingRule::Aligned } else { HeadingRule::Held };
    };
    "similar_log_ratio", "0 to 1", 0.0..=1.0, |s, v| {
        s.paper.similar_log_ratio = v;
        s.keeper.rule.similar_log_ratio = v;
    };
    "full_log_ratio", "0.01 to 5", 0.01..=5.0, |s, v| s.keeper.rule.full_log_ratio = v;
    "alignment", "0 to 1", 0.0..=1.0, |s, v| s.keeper.alignment = v;
    "pull_max", "0 to 10", 0.0..=10.0, |s, v| s.keeper.rule.pull_max = v;
    "gain_mps", "0 to 2 m/s", 0.0..=2.0, |s, v| s.keeper.rule.gain_mps = v;
    "preferred_m", "1 to 50 m", 1.0..=50.0, |s, v| {
        s.paper.preferred_m = v;
        s.paper.preferred_forward_m = 1.3 * v;
        s.keeper.rule.preferred_m = v;
        s.keeper.rule.preferred_forward_m = 1.3 * v;
        s.swarm.start_distance_m = v;
    };
    "distance_m_min", "0 to 10 m", 0.0..=10.0, |s, v| s.keeper.safety.distance_m_min = v;
    "gust_m", "0 to 10 m", 0.0..=10.0, |s, v| s.keeper.safety.gust_m = v;
    "clearance_m_min", "0 to 10 m", 0.0..=10.0, |s, v| s.keeper.safety.clearance_m_min = v;
    "slower_mps_min", "0 to 10 m/s", 0.0..=10.0, |s, v| s.keeper.safety.slower_mps_min = v;
    "approach_hz", "0.1 to 10 per second", 0.1..=10.0, |s, v| s.keeper.safety.approach_hz = v;
};

const BASELINE: Setting = Setting {
    name: "marker_baseline",
    expected: "all_round, vertical or horizontal",
    apply: |scenario, text| {
        let sensing = &mut scenario.swarm.sensing;
        sensing.baseline = match text {
            "all_round" => LightBaseline::AllRound,
            "vertical" => LightBaseline::Vertical,
            "horizontal" => LightBaseline::Horizontal,
            _ => return None,
        };
        Some(())
    },
};

/// Those of rendered pictures.
const PICTURED: [Setting; 2] = [
    Setting {
        name: "lamps",
        expected: "0 to 100 lamps",
        apply: |scenario, text| {
            scenario.pictures.as_mut()?.lamp_count = number(text, 0.0, 100.0)? as usize;
            Some(())
        },
    },
    Setting {
        name: "noise_levels",
        expected: "0 to 50 grey levels",
        apply: |scenario, text| {
            scenario.pictures.as_mut()?.noise = number(text, 0.0, 50.0)?;
            Some(())
        },
    },
];

fn settings() -> impl Iterator<Item = &'static Setting> {
    NUMBERS.iter().chain([&BASELINE]).chain(&PICTURED)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scenario() -> Scenario {
        Scenario::new(RuleName::Gabriel, SensingName::Realistic)
    }

    #[test]
    fn every_name_of_the_command_line_is_known() {
        let mut scenario = scenario();
        for text in [
            "latency_s=1",
            "missed=0.5",
            "marker_baseline=horizontal",
            "elevation_deg=41",
            "noise_px=0.3",
        ] {
            assert_eq!(scenario.set(text), Ok(()), "{text}");
        }
        assert_eq!(scenario.swarm.sensing.latency_s, 1.0);
        assert_eq!(scenario.swarm.sensing.baseline, LightBaseline::Horizontal);
    }

    #[test]
    fn settings_of_pictures_are_for_pictures() {
        let error = scenario().set("lamps=3").unwrap_err();
        assert!(error.to_string().contains("--sensing rendered"), "{error}");
        let mut pictured = Scenario::new(RuleName::Gabriel, SensingName::Rendered);
        assert_eq!(pictured.set("lamps=3"), Ok(()));
        assert_eq!(pictured.pictures.unwrap().lamp_count, 3);
        assert_eq!(pictured.check(), Ok(()));
        pictured.swarm.drone_count = 21;
        assert!(pictured.check().unwrap_err().to_string().contains("21"));
        pictured.swarm.drone_count = 2;
        assert_eq!(pictured.set("marker_baseline=vertical"), Ok(()));
        assert_eq!(pictured.check(), Err(SettingError::PicturedBaseline));
    }

    #[test]
    fn wrong_settings_say_what_is_right() {
        let mut scenario = scenario();
        let message =
            |scenario: &mut Scenario, text: &str| scenario.set(text).unwrap_err().to_string();
        assert!(message(&mut scenario, "latency").contains("NAME=VALUE"));
        assert!(message(&mut scenario, "lateness=1").contains("latency_s"));
        assert!(message(&mut scenario, "missed=2").contains("a share from 0 to 1"));
        assert!(message(&mut scenario, "marker_baseline=up").contains("horizontal"));
        assert!(message(&mut scenario, "noise_px=NaN").contains("0 to 10 px"));
    }
}
