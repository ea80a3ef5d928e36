//! How many base parameters an arm has, with and without gravity along axis 1.

use plumbline::model::base::Reduction;
use plumbline::model::chain::{Chain, Joint, JointKind, Placement};
use plumbline::model::gravity::Mounting;
use std::f64::consts::FRAC_PI_2;

#[test]
fn panda_has_45_in_any_mounting_and_43_upright() {
    let rows = [
        (0.0, 0.0, 0.333),
        (0.0, -FRAC_PI_2, 0.0),
        (0.0, FRAC_PI_2, 0.316),
        (0.0825, FRAC_PI_2, 0.0),
        (-0.0825, -FRAC_PI_2, 0.384),
        (0.0, FRAC_PI_2, 0.0),
        (0.088, FRAC_PI_2, 0.0),
    ];
    let joints = rows.map(|(a, alpha, d)| Joint { kind: JointKind::Revolute, a, alpha, d, theta: 0.0 }).to_vec();
    let chain = Chain::modified(joints, Placement::identity());
    assert_eq!(Reduction::any_mounting(&chain).len(), 45);
    assert_eq!(Reduction::in_mounting(&chain, &Mounting::WALL).len(), 45);
    assert_eq!(Reduction::in_mounting(&chain, &Mounting::UPRIGHT).len(), 43);
}
