//! What `hil/python/test_plumbline.py` needs of Rust.
//!
//!     python-peer expected FOLDER        models of every shipped arm, random states, and the Rust call's torques
//!     python-peer layout ROBOT types     serves messages of other sizes until standard input ends
//!     python-peer layout ROBOT number    the same with another number of the layout in the model's header

use plumbline_client::Model;
use plumbline_ipc::RobotId;
use plumbline_model::{Mounting, Reduction, Robot, Structure, TorqueModel};
use plumbline_model_file::{ModelFile, Provenance};
use plumbline_testkit::arms::{chain, draw};
use plumbline_testkit::other_layout::{Other, OtherDaemon};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::path::Path;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["expected", folder] => expected(Path::new(folder)),
        ["layout", robot, "types"] => layout(robot, Other::Types),
        ["layout", robot, "number"] => layout(robot, Other::Number),
        _ => panic!("{arguments:?}: `expected FOLDER`, `layout ROBOT types` or `layout ROBOT number`"),
    }
}

/// `ROBOT.toml`, `ROBOT.states` (10,000 rows of q, dq, ddq) and `ROBOT.torques`, doubles in the machine's order.
fn expected(folder: &Path) {
    const WALL: [f64; 3] = [9.81, 0.0, 0.0];
    for robot in Robot::names() {
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let chain = chain(robot);
        let terms = ["friction", "torque-offset", "rotor-inertia"];
        let structure = Structure::of(chain.clone(), Reduction::any_mounting(&chain), &terms).unwrap();
        let values: Vec<_> =
            draw(&mut rng, structure.columns().len(), 1.0).into_iter().map(|value| (value, None)).collect();
        let model = TorqueModel::new(robot, structure, vec![Mounting::WALL], &values).unwrap();
        let (noise_floor, validation, provenance) = (Vec::new(), Vec::new(), Provenance::default());
        let file = ModelFile { model, noise_floor, validation, uncertainty: None, consistent: None, provenance };
        let path = folder.join(format!("{robot}.toml"));
        std::fs::write(&path, file.to_toml()).unwrap();
        let mut model = Model::load(&path, WALL).unwrap();
        let n = model.joints().unwrap();
        let (mut states, mut torques, mut tau) = (Vec::new(), Vec::new(), vec![0.0; n]);
        for _ in 0..10_000 {
            let [q, dq, ddq] = [3.0, 2.0, 5.0].map(|span| draw(&mut rng, n, span));
            model.torque(&q, &dq, &ddq, None, &mut tau).unwrap();
            states.extend([q, dq, ddq].concat().into_iter().flat_map(f64::to_ne_bytes));
            torques.extend(tau.iter().copied().flat_map(f64::to_ne_bytes));
        }
        std::fs::write(folder.join(format!("{robot}.states")), states).unwrap();
        std::fs::write(folder.join(format!("{robot}.torques")), torques).unwrap();
    }
}

fn layout(robot: &str, other: Other) {
    let _daemon = OtherDaemon::start(&RobotId::parse("the call", "robot", robot).unwrap(), other);
    println!("serves");
    std::io::copy(&mut std::io::stdin(), &mut std::io::sink()).unwrap();
}
