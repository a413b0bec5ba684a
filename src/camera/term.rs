//! An effect in force. Files have its parameters by name.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::effects::{AnyDisplacement, displacement};

/// An effect in force with its parameters.
///
/// In files the parameters stand by name; a list in the order in which the effect has them, as files before version 2 of their formats have it, is read too.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "TermInFile", into = "TermInFile")]
pub struct Term {
    /// Its id.
    pub effect: String,
    /// Its parameters, in the order in which the effect lists them.
    pub parameters: Vec<f64>,
}

/// The same as files have it.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
struct TermInFile {
    /// Its id.
    effect: String,
    /// Its parameters.
    parameters: ParametersInFile,
}

/// Parameters as files have them.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
enum ParametersInFile {
    /// By name.
    ByName(BTreeMap<String, f64>),
    /// In the order of the effect.
    InOrder(Vec<f64>),
}

impl From<Term> for TermInFile {
    fn from(term: Term) -> Self {
        let specs = displacement(&term.effect).map(AnyDisplacement::parameters).filter(|specs| specs.len() == term.parameters.len());
        let parameters = match specs {
            Some(specs) => ParametersInFile::ByName(specs.iter().map(|spec| spec.name.to_owned()).zip(term.parameters).collect()),
            None => ParametersInFile::InOrder(term.parameters),
        };
        Self { effect: term.effect, parameters }
    }
}

impl TryFrom<TermInFile> for Term {
    type Error = String;

    fn try_from(TermInFile { effect, parameters }: TermInFile) -> Result<Self, String> {
        let mut by_name = match parameters {
            ParametersInFile::InOrder(parameters) => return Ok(Self { effect, parameters }),
            ParametersInFile::ByName(by_name) => by_name,
        };
        let known = displacement(&effect).ok_or_else(|| format!("there is no displacement {effect:?}; `boresight effects` lists them"))?;
        let specs = known.parameters();
        let parameters: Option<Vec<f64>> = specs.iter().map(|spec| by_name.remove(spec.name)).collect();
        let names = || specs.iter().map(|spec| spec.name).collect::<Vec<_>>().join(", ");
        match (parameters, by_name.keys().next()) {
            (Some(parameters), None) => Ok(Self { effect, parameters }),
            (Some(_), Some(other)) => Err(format!("{effect} has no parameter {other:?}; it has {}", names())),
            (None, _) => Err(format!("{effect} lacks a parameter; it has {}", names())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::DISPLACEMENTS;

    #[test]
    fn parameters_stand_by_name_and_are_read_in_both_ways() {
        for effect in DISPLACEMENTS {
            let parameters: Vec<f64> = (0..effect.parameters().len()).map(|k| 0.5 + k as f64).collect();
            let term = Term { effect: effect.id().to_owned(), parameters };
            let text = serde_json::to_value(&term).unwrap();
            for (spec, value) in effect.parameters().iter().zip(&term.parameters) {
                assert_eq!(text["parameters"][spec.name], *value, "{text}");
            }
            assert_eq!(serde_json::from_value::<Term>(text).unwrap(), term);
            let older = serde_json::json!({ "effect": term.effect, "parameters": term.parameters });
            assert_eq!(serde_json::from_value::<Term>(older).unwrap(), term);
        }
    }

    #[test]
    fn a_name_that_is_not_the_effects_is_refused() {
        let read = |text: &str| serde_json::from_str::<Term>(text).unwrap_err().to_string();
        let effect = DISPLACEMENTS.iter().find(|effect| effect.parameters().len() == 1).unwrap();
        let (id, name) = (effect.id(), effect.parameters()[0].name);
        let more = read(&format!(r#"{{"effect": "{id}", "parameters": {{"{name}": 1.0, "k99": 2.0}}}}"#));
        assert!(more.contains("k99") && more.contains(name) && more.contains(id), "{more}");
        let less = read(&format!(r#"{{"effect": "{id}", "parameters": {{}}}}"#));
        assert!(less.contains("lacks") && less.contains(name), "{less}");
        let unknown = read(r#"{"effect": "no-such", "parameters": {"x": 1.0}}"#);
        assert!(unknown.contains("no-such"), "{unknown}");
    }
}
