//! `when` of a requirement: for which values of the sweep it applies.

/// A comparison of the swept value.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Comparison {
    AtMost(f64),
    AtLeast(f64),
    Below(f64),
    Above(f64),
    Equal(f64),
    Unequal(f64),
}

impl Comparison {
    fn holds(self, value: f64) -> bool {
        match self {
            Self::AtMost(limit) => value <= limit,
            Self::AtLeast(limit) => value >= limit,
            Self::Below(limit) => value < limit,
            Self::Above(limit) => value > limit,
            Self::Equal(limit) => value == limit,
            Self::Unequal(limit) => value != limit,
        }
    }
}

/// Makes a comparison of its limit.
type Make = fn(f64) -> Comparison;

/// Comparisons that all must hold.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct When(Vec<Comparison>);

impl When {
    /// Reads `rate <= 1.0 and rate > 0`; `name` is what the sweep is called.
    pub(super) fn parse(text: &str, name: &str) -> Result<Self, String> {
        let one = |part: &str| {
            const SIGNS: [(&str, Make); 6] = [
                ("<=", Comparison::AtMost),
                (">=", Comparison::AtLeast),
                ("==", Comparison::Equal),
                ("!=", Comparison::Unequal),
                ("<", Comparison::Below),
                (">", Comparison::Above),
            ];
            let fault = || format!("when = {text:?}: {part:?} is no comparison; write one as in \"{name} <= 1.0\"");
            let (sign, make) = SIGNS.iter().find(|(sign, _)| part.contains(sign)).ok_or_else(fault)?;
            let (left, right) = part.split_once(sign).ok_or_else(fault)?;
            if left.trim() != name {
                return Err(format!("when = {text:?}: {} is unknown; the sweep is called {name}", left.trim()));
            }
            let number = match right.trim() {
                "true" => Some(1.0),
                "false" => Some(0.0),
                number => number.parse::<f64>().ok(),
            };
            number.map(make).ok_or_else(fault)
        };
        text.split(" and ").map(|part| one(part.trim())).collect::<Result<Vec<_>, String>>().map(Self)
    }

    /// Whether a value is meant; truth values count as 0 and 1.
    pub(super) fn holds(&self, value: &toml::Value) -> bool {
        let number = match value {
            toml::Value::Float(number) => *number,
            toml::Value::Integer(number) => *number as f64,
            toml::Value::Boolean(is) => f64::from(u8::from(*is)),
            _ => return false,
        };
        self.0.iter().all(|comparison| comparison.holds(number))
    }
}

#[cfg(test)]
mod tests {
    use toml::Value;

    use super::*;

    #[test]
    fn comparisons_are_read_and_held() {
        let when = When::parse("rate <= 1.0 and rate > 0", "rate").unwrap();
        let holds = |value| when.holds(&value);
        assert!(holds(Value::Float(1.0)) && holds(Value::Integer(1)) && !holds(Value::Float(0.0)) && !holds(Value::Float(1.1)));
        assert!(!holds(Value::String("a".to_owned())));
        assert!(When::parse("on == true", "on").unwrap().holds(&Value::Boolean(true)));
        assert_eq!(When::parse("speed < 1", "rate").unwrap_err(), "when = \"speed < 1\": speed is unknown; the sweep is called rate");
        assert!(When::parse("rate", "rate").is_err() && When::parse("rate < fast", "rate").is_err());
    }
}
