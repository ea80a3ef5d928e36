//! Physical consistency of the identified parameters.

use plumbline_identify::consistency::Nearest;
use plumbline_model::TorqueModel;
use serde::{Deserialize, Serialize};

const NAMED: usize = 3;
/// Smallest reported change of a parameter, in standard deviations.
const MOVED: f64 = 0.01;

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Consistency {
    pub exact: bool,
    /// Mahalanobis distance of the nearest consistent parameters, in standard deviations.
    pub distance: f64,
    /// Metric of the distance, as text.
    pub weights: String,
    /// Parameters that moved, the farthest first.
    pub moved: Vec<Moved>,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Moved {
    pub name: String,
    pub value: f64,
    /// Change from the estimate, in standard deviations.
    pub deviations: f64,
}

impl Consistency {
    pub fn of_model(model: &TorqueModel, found: &Nearest) -> Consistency {
        let names: Vec<&str> = model.structure().columns().iter().map(|column| column.name.as_str()).collect();
        Consistency::of(found, &names)
    }

    /// Consistency of nearest bodies; `names` are those of the columns.
    fn of(found: &Nearest, names: &[&str]) -> Consistency {
        let mut moved: Vec<Moved> = names
            .iter()
            .zip(found.moved.iter().zip(&found.beta))
            .filter(|(_, (deviations, _))| deviations.abs() > MOVED)
            .map(|(name, (deviations, value))| Moved { name: name.to_string(), value: *value, deviations: *deviations })
            .collect();
        moved.sort_by(|a, b| b.deviations.abs().total_cmp(&a.deviations.abs()));
        Consistency { exact: found.exact, distance: found.distance, weights: found.weights.text().to_string(), moved }
    }

    pub fn sentence(&self) -> String {
        if self.exact {
            return "physically consistent: yes, real bodies have exactly these parameters".into();
        }
        let each = |moved: &Moved| format!("{} by {:+.2}", moved.name, moved.deviations);
        let named: Vec<String> = self.moved.iter().take(NAMED).map(each).collect();
        let farthest = if named.is_empty() { String::new() } else { format!("; farthest {}", named.join(", ")) };
        format!(
            "physically consistent: no, the nearest real bodies are {:.2} standard deviations away ({}){farthest}",
            self.distance, self.weights
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_identify::consistency::Weights;

    fn found(exact: bool, moved: Vec<f64>) -> Nearest {
        let (links, rotors) = (Vec::new(), Vec::new());
        let (beta, weights) = (vec![1.0; moved.len()], Weights::Covariance);
        Nearest { links, rotors, beta, exact, distance: 3.456, moved, weights, iterations: 20 }
    }

    #[test]
    fn the_sentence_names_what_moved_farthest() {
        let names = ["Lxx1", "Lzz1", "lx1", "ly1", "Lzz7"];
        let facts = Consistency::of(&found(false, vec![0.5, -1.5, 0.001, 0.7, 2.25]), &names);
        assert_eq!(facts.moved.len(), 4);
        assert_eq!(
            facts.sentence(),
            "physically consistent: no, the nearest real bodies are 3.46 standard deviations away (in the estimate's covariance); farthest \
             Lzz7 by +2.25, Lzz1 by -1.50, ly1 by +0.70"
        );
        assert!(Consistency::of(&found(true, vec![0.0; 5]), &names).sentence().contains("yes"));
    }
}
