//! What goes wrong with the network, for a person.

use std::str::FromStr;

use zenoh::config::EndPoint;

/// Why there is no session.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    #[error("{got:?} is no endpoint: {reason}; expected such as tcp/127.0.0.1:7447")]
    Endpoint { got: String, reason: String },
    #[error("zenoh refuses {field} = {value}: {reason}")]
    Setting {
        field: String,
        value: String,
        reason: String,
    },
    #[error("cannot listen on {endpoints}: {reason}")]
    Listen { endpoints: String, reason: String },
    #[error("cannot connect to {endpoints}; is a starling vehicle up there?")]
    Connect { endpoints: String },
    #[error("zenoh cannot declare {what}: {reason}")]
    Declare { what: String, reason: String },
}

impl LinkError {
    pub(super) fn listen(endpoints: &[String], error: &zenoh::Error) -> Self {
        let reason = plain(&error.to_string());
        let reason = if reason.contains("Address already in use") {
            "port in use; choose another one, or 0 for any that is free".to_owned()
        } else {
            reason
        };
        Self::Listen {
            endpoints: endpoints.join(", "),
            reason,
        }
    }

    pub(super) fn declare(what: &str, error: &zenoh::Error) -> Self {
        Self::Declare {
            what: what.to_owned(),
            reason: plain(&error.to_string()),
        }
    }
}

/// Endpoints that zenoh would refuse in words of its own, or try for ever.
pub(super) fn check_endpoints(endpoints: &[String]) -> Result<(), LinkError> {
    for endpoint in endpoints {
        check_endpoint(endpoint).map_err(|reason| LinkError::Endpoint {
            got: endpoint.clone(),
            reason,
        })?;
    }
    Ok(())
}

fn check_endpoint(text: &str) -> Result<(), String> {
    let endpoint = EndPoint::from_str(text).map_err(|error| plain(&error.to_string()))?;
    let protocol = endpoint.protocol().as_str().to_owned();
    if !["tcp", "udp", "tls", "quic"].contains(&protocol.as_str()) {
        return Err(format!("protocol {protocol:?} is not built in"));
    }
    let address = endpoint.address().as_str().to_owned();
    let port = address.rsplit_once(':').map(|(_, port)| port);
    match port.map(str::parse::<u16>) {
        Some(Ok(_)) => Ok(()),
        Some(Err(_)) => Err("its port is no number up to 65535".to_owned()),
        None => Err("it has no port".to_owned()),
    }
}

/// zenoh's errors without the places in its source that they name.
pub(super) fn plain(text: &str) -> String {
    let mut pieces = text.split(" at ");
    let mut plain = pieces.next().unwrap_or_default().to_owned();
    for piece in pieces {
        match after_source_place(piece) {
            Some(rest) => plain += rest,
            None => {
                plain += " at ";
                plain += piece;
            }
        }
    }
    plain
}

/// What follows `…/file.rs:123.` at the start of a text.
fn after_source_place(text: &str) -> Option<&str> {
    let (path, rest) = text.split_once(".rs:")?;
    (!path.contains(char::is_whitespace)).then_some(())?;
    let rest = rest.trim_start_matches(|letter: char| letter.is_ascii_digit());
    Some(rest.strip_prefix('.').unwrap_or(rest))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_in_foreign_source_are_left_out() {
        let cases = [
            ("no answer at all", "no answer at all"),
            (
                "cannot bind: [in use (os error 98) at /a/b-1.2/tcp.rs:61.] at io/x/uni.rs:338.",
                "cannot bind: [in use (os error 98)]",
            ),
            (
                "refused at /x/y.rs:9. - Caused by timeout at z.rs:1.",
                "refused - Caused by timeout",
            ),
        ];
        for (text, expected) in cases {
            assert_eq!(plain(text), expected);
        }
    }

    #[test]
    fn endpoints_are_checked_before_zenoh_sees_them() {
        let check = |text: &str| check_endpoints(&[text.to_owned()]);
        for text in [
            "tcp/127.0.0.1:0",
            "tcp/[::1]:7447",
            "udp/host:7447",
            "tls/a.b:1#c=d",
        ] {
            assert!(check(text).is_ok(), "{text}");
        }
        for text in [
            "",
            "foo",
            "tcp/127.0.0.1",
            "tcp/127.0.0.1:80x",
            "tcp/h:70000",
            "ws/h:80",
        ] {
            let error = check(text).unwrap_err().to_string();
            assert!(error.contains("is no endpoint"), "{error}");
            assert!(!error.contains(".rs"), "{error}");
        }
    }
}
