//! Nominal model of a plan's torques, restricted to terms with a gradient.

use super::ExciteError;
use nalgebra::Vector3;
use plumbline_core::{JointVec, MAX_JOINTS};
use plumbline_model::term::Entry;
use plumbline_model::term::friction::SHARPNESS;
use plumbline_model::{Chain, LINK_COLUMNS, LinkParameters, TorqueModel, rnea};

/// Nominal model: rigid body, friction, offsets and rotors of an arm.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Nominal {
    /// Standard parameters of every link, or base parameters in the slots of their names.
    pub links: Vec<LinkParameters>,
    /// Viscous friction \[Nms/rad\].
    pub fv: JointVec,
    /// Coulomb friction \[Nm\].
    pub fc: JointVec,
    /// Torque offsets \[Nm\].
    pub offset: JointVec,
    /// Rotor inertias \[kg m2\].
    pub rotor: JointVec,
}

impl Nominal {
    /// Nominal model of `model`. A payload becomes part of the last link; [`Nominal::left_out`] lists the omitted effects.
    ///
    /// # Errors
    /// A term without a spec of another kind: its torque would be missing.
    pub fn of(model: &TorqueModel) -> Result<Nominal, ExciteError> {
        let structure = model.structure();
        let mut nominal =
            Nominal { links: vec![LinkParameters::default(); structure.chain().len()], ..Nominal::default() };
        for (term, parameters) in model.terms() {
            if term.spec().is_some() {
                continue;
            }
            let entries = term.entries().unwrap_or_default();
            for (index, parameter) in parameters.iter().enumerate() {
                let slot = match entries.get(index).copied() {
                    Some(Entry::Link { slot }) => &mut nominal.links[slot / LINK_COLUMNS][slot % LINK_COLUMNS],
                    Some(Entry::Velocity { joint }) => &mut nominal.fv[joint],
                    Some(Entry::SmoothSign { joint }) => &mut nominal.fc[joint],
                    Some(Entry::Constant { joint }) => &mut nominal.offset[joint],
                    Some(Entry::Acceleration { joint }) => &mut nominal.rotor[joint],
                    None => {
                        let (term, name) = (term.id().to_string(), parameter.column.name.clone());
                        return Err(ExciteError::Column { term, name });
                    }
                };
                *slot = parameter.value;
            }
        }
        if let Some(last) = nominal.links.last_mut() {
            last.iter_mut().zip(model.on_last_link()).for_each(|(own, payload)| *own += payload);
        }
        Ok(nominal)
    }

    /// Effects of a model that [`Nominal::of`] omits: they are small against the torque limits.
    pub fn left_out(model: &TorqueModel) -> Vec<&'static str> {
        let mut ids: Vec<&str> = Vec::new();
        for spec in model.structure().terms().iter().filter_map(|term| term.spec()) {
            if !spec.is_on_last_link() && !ids.contains(&spec.family) {
                ids.push(spec.family);
            }
        }
        ids
    }

    /// Torque at a point of a motion, by the Newton-Euler recursion \[Nm\]; `gravity` is the gravitational acceleration in the base
    /// frame \[m/s2\]. Panics when the model is of another arm.
    pub fn torque(
        &self,
        chain: &Chain,
        gravity: &Vector3<f64>,
        q: &JointVec,
        dq: &JointVec,
        ddq: &JointVec,
    ) -> JointVec {
        let n = chain.len();
        assert_eq!(self.links.len(), n, "links of the nominal model and of the arm");
        let mut tau = [0.0; MAX_JOINTS];
        rnea(chain, &self.links, gravity, q, dq, ddq, &mut tau);
        for j in 0..n {
            tau[j] += self.fv[j] * dq[j] + self.fc[j] * (SHARPNESS * dq[j]).tanh();
            tau[j] += self.offset[j] + self.rotor[j] * ddq[j];
        }
        tau
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_model::term::Sample;
    use plumbline_model::term::effect::{Site, Spec};
    use plumbline_model::{Joint, JointKind, Placement, Reduction, Structure};

    #[test]
    fn the_nominal_torque_is_that_of_the_model() {
        let joint = |alpha: f64| Joint { kind: JointKind::Revolute, a: 0.1, alpha, d: 0.2, theta: 0.0 };
        let chain = Chain::modified(vec![joint(0.0), joint(1.2), joint(-0.7)], Placement::identity());
        let ids = ["friction", "torque-offset", "rotor-inertia"];
        let structure = Structure::of(chain.clone(), Reduction::any_mounting(&chain), &ids).unwrap();
        let values: Vec<_> = (0..structure.columns().len()).map(|c| ((c as f64 * 1.7).sin(), None)).collect();
        let model = TorqueModel::new("arm", structure, vec![], &values).unwrap();
        let gravity = Vector3::new(1.0, -2.0, 9.0);
        let (q, dq, ddq) = ([0.3; 8], [-0.7; 8], [1.9; 8]);
        let sample = Sample { q, dq, ddq };
        let expected = model.evaluator(&gravity).torque(&sample).0;
        let found = Nominal::of(&model).unwrap().torque(&chain, &gravity, &q, &dq, &ddq);
        assert!((0..3).all(|j| (found[j] - expected[j]).abs() < 1e-12), "{found:?} {expected:?}");
        assert!(Nominal::left_out(&model).is_empty());

        // A payload is included; other effects are listed as omitted.
        let with = |family, site, settings| {
            let spec = Spec { family, form: "", site, settings };
            let term = spec.build(&model.structure().operating_point(&model.beta())).unwrap();
            let structure = model.structure().clone().with(vec![term]).unwrap();
            let values: Vec<_> = (0..structure.columns().len()).map(|c| ((c as f64 * 1.7).sin(), None)).collect();
            TorqueModel::new("arm", structure, vec![], &values).unwrap()
        };
        let loaded = with("payload", Site::Arm, vec![]);
        let expected = loaded.evaluator(&gravity).torque(&sample).0;
        let found = Nominal::of(&loaded).unwrap().torque(&chain, &gravity, &q, &dq, &ddq);
        assert!((0..3).all(|j| (found[j] - expected[j]).abs() < 1e-12), "{found:?} {expected:?}");
        assert!(Nominal::left_out(&loaded).is_empty());
        let bent = with("presliding", Site::Joint(1), vec![0.01]);
        assert_eq!(Nominal::left_out(&bent), ["presliding"]);
        assert_eq!(Nominal::of(&bent).unwrap(), Nominal::of(&model).unwrap());
    }
}
