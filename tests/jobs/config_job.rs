//! The job configuration: shipped files load, every bad value is refused by name, overrides win over the file.

use plumbline::config::job::franka::Recovery;
use plumbline::config::job::{Job, OnEstimatorLoss, Pace, Resource};
use plumbline_franka::Interface;
use plumbline_identify::Settings;
use plumbline_model::Mounting;
use std::path::Path;

const LEAST: &str = "robot = \"panda\"\nmounting = \"wall\"\n[backend]\nkind = \"sim\"\narm = \"sim-panda\"\n";

fn parse(text: &str, sets: &[&str]) -> Result<Job, String> {
    let sets: Vec<String> = sets.iter().map(|set| set.to_string()).collect();
    Job::parse(Path::new("conf/job.toml"), text, &sets).map_err(|bad| bad.to_string())
}

fn refusal(text: &str, sets: &[&str]) -> String {
    parse(text, sets).expect_err("a refusal")
}

#[test]
fn every_shipped_job_loads() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("config");
    let mut jobs = 0;
    for entry in std::fs::read_dir(&folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|end| end == "toml") {
            let job = Job::load(&path, &[]).unwrap_or_else(|bad| panic!("{bad}"));
            let robot = folder.join("robots").join(format!("{}.toml", job.robot));
            assert!(!folder.join("robots").exists() || robot.exists(), "{} is not shipped", job.robot);
            if let Some(Resource::File(arm)) = &job.backend.arm {
                assert!(!folder.join("arms").exists() || arm.exists(), "{} is not shipped", arm.display());
            }
            jobs += 1;
        }
    }
    assert!(jobs >= 1);
}

#[test]
fn the_minimal_job_has_every_default() {
    let job = parse(LEAST, &[]).unwrap();
    assert_eq!(job.mounting, Mounting::WALL);
    assert_eq!((job.excitation.harmonics, job.excitation.period, job.excitation.periods), (5, 10.0, 10));
    assert_eq!(job.validation.mountings, [Mounting::WALL, Mounting::UPRIGHT]);
    assert_eq!(job.backend.arm, Some(Resource::BuiltIn("sim-panda".into())));
    assert_eq!((job.backend.pace, job.safety.on_estimator_loss), (Pace::Fast, OnEstimatorLoss::Finish));
    assert!(job.output.dataset && job.excitation.plan.is_none() && job.workspace.is_none());
}

#[test]
fn quantities_are_read_in_their_units() {
    let text = LEAST.replace("\"wall\"", "{ rho = \"60 deg\", phi = \"0.5 rad\" }")
        + "[excitation]\nperiod = \"2500 ms\"\nq0 = [\"90 deg\", \"0.1 m\"]\n\
           [estimator]\ntorque-cutoff = \"5 Hz\"\n[safety]\ntracking-error = \"3 deg\"\n";
    let job = parse(&text, &[]).unwrap();
    assert_eq!(job.mounting, Mounting { rho: 60_f64.to_radians(), phi: 0.5 });
    assert_eq!(job.excitation.period, 2.5);
    assert_eq!(job.excitation.q0, Some(vec![90_f64.to_radians(), 0.1]));
    assert_eq!(job.estimator.torque_cutoff, Some(5.0));
    assert_eq!((job.settings().torque_cutoff, job.settings().order), (5.0, Settings::default().order));
    assert!((job.safety.tracking_error - 3_f64.to_radians()).abs() < 1e-15);
}

#[test]
fn every_bad_value_is_named() {
    let cases = [
        (
            "[excitation]\nperods = 3\n",
            "line 7, key `excitation.perods`: got `perods`, expected a known key (unknown field",
        ),
        ("[exitation]\n", "line 6"),
        ("[excitation]\nperiods = 0\n", "key `excitation.periods`: got 0, expected 1 to 1000"),
        ("[excitation]\nperiods = -1\n", "line 7, key `excitation.periods`: got `-1`"),
        ("[excitation]\nperiod = 10\n", "key `excitation.period`: got `10`, expected a duration with its unit"),
        ("[excitation]\nperiod = \"10.0005 s\"\n", "whole milliseconds"),
        ("[excitation]\nharmonics = 40\n", "key `excitation.harmonics`: got 40"),
        ("[excitation]\nlead-in = 1000\n", "key `excitation.lead-in`"),
        ("[excitation]\nstarts = 0\n", "key `excitation.starts`"),
        ("[excitation]\nrounds = 100000\n", "key `excitation.rounds`"),
        ("[excitation]\ncriterion = \"best\"\n", "key `excitation.criterion`: got `\"best\"`"),
        ("[excitation]\nq0 = [1.0]\n", "key `excitation.q0[0]`"),
        ("[excitation]\nq0 = []\n", "key `excitation.q0`: got 0 values"),
        ("[validation]\nmountings = [\"floor\"]\n", "key `validation.mountings[0]`: got `\"floor\"`"),
        ("[validation]\ntrajectories = 101\n", "key `validation.trajectories`"),
        ("[limits]\nspeed = 1.1\n", "key `limits.speed`: got 1.1, expected a share"),
        ("[limits]\njerk = nan\n", "key `limits.jerk`: got NaN"),
        ("[limits]\nmargin = \"90 deg\"\n", "key `limits.margin`"),
        ("[workspace]\nbox-min = [0, 0, 0]\nbox-max = [1, 1, 0]\nbase-radius = 0.1\n", "key `workspace.box-min[2]`"),
        ("[workspace]\nbox-min = [0, 0]\nbox-max = [1, 1, 0]\nbase-radius = 0.1\n", "key `workspace.box-min"),
        ("[estimator]\ntorque-cutoff = \"5000 Hz\"\n", "key `estimator.torque-cutoff`: got 5000 Hz"),
        ("[estimator]\nfilter-order = 3\n", "key `estimator.filter-order`: got 3"),
        ("[realtime]\npriority = 100\n", "key `realtime.priority`: got 100"),
        ("[safety]\ntracking-error = \"0 rad\"\n", "key `safety.tracking-error`"),
        ("[safety]\nmax-lost = 0\n", "key `safety.max-lost`"),
        ("[safety]\non-estimator-loss = \"pray\"\n", "key `safety.on-estimator-loss`"),
        ("[serve]\nstale-after = \"5 ms\"\n", "line 7, key `serve.stale-after`"),
        ("[output]\ndir = \"\"\n", "key `output.dir`"),
        ("pace = \"slow\"\n", "key `backend.pace`: got `\"slow\"`"),
        ("pace = ", "line 6"),
    ];
    for (more, expected) in cases {
        let message = refusal(&format!("{LEAST}{more}"), &[]);
        assert!(
            message.starts_with("conf/job.toml: ") && message.contains(expected),
            "`{message}` does not say `{expected}`"
        );
    }
    for missing in ["robot", "mounting", "kind"] {
        let message = refusal(&LEAST.replace(&format!("{missing} = "), &format!("# {missing} = ")), &[]);
        assert!(message.contains(&format!("missing field `{missing}`")), "{message}");
    }
    let no_arm = refusal(&LEAST.replace("arm = ", "# arm = "), &[]);
    assert!(no_arm.contains("key `backend.arm`: got nothing, expected the arm to simulate"), "{no_arm}");
    assert!(refusal(&LEAST.replace("\"sim\"", "\"real\""), &[]).contains("key `backend.kind`: got `\"real\"`"));
}

const FRANKA: &str =
    "robot = \"panda\"\nmounting = \"wall\"\n[validation]\nmountings = [\"wall\"]\n[backend]\nkind = \"franka\"\n";

#[test]
fn a_franka_needs_an_address_and_has_defaults_for_the_rest() {
    let job = parse(&format!("{FRANKA}[backend.franka]\naddress = \"172.16.0.2\"\n"), &[]).unwrap();
    let franka = job.backend.franka.unwrap();
    assert_eq!(franka.address.to_string(), "172.16.0.2");
    assert_eq!((franka.interface, franka.recovery), (Interface::JointPosition, Recovery::Operator));
    assert_eq!((franka.max_recoveries, franka.state_timeout), (2, 0.1));
    let patient = format!("{FRANKA}[backend.franka]\naddress = \"172.16.0.2\"\n[safety]\nmax-lost = 20\n");
    assert!(refusal(&patient, &[]).contains("key `safety.max-lost`: got 20, expected 1 to 19 states"));

    let address = "[backend.franka]\naddress = \"172.16.0.2\"\n";
    let elsewhere = refusal(&format!("{}{address}", FRANKA.replace("[\"wall\"]", "[\"wall\", \"upright\"]")), &[]);
    assert!(elsewhere.contains("key `validation.mountings`: got `upright`"), "{elsewhere}");
    assert!(refusal(FRANKA, &[]).contains("key `backend.franka`: got nothing, expected a table"));
    // Before anything is planned: a description of one's own makes no other arm a Franka.
    for own in ["arms/mine.toml", "ur10"] {
        let other = refusal(&format!("{}{address}", FRANKA.replace("\"panda\"", &format!("\"{own}\""))), &[]);
        assert!(other.contains(&format!("key `robot`: got `{own}`, expected panda or fr3")), "{other}");
    }
    let both = format!("{FRANKA}arm = \"sim-panda\"\n[backend.franka]\naddress = \"172.16.0.2\"\n");
    assert!(refusal(&both, &[]).contains("key `backend.arm`: got a value, expected none"));
    assert!(
        refusal(&format!("{LEAST}[backend.franka]\naddress = \"172.16.0.2\"\n"), &[]).contains("key `backend.franka`")
    );
    let cases = [
        ("address = \"robot.local\"\n", "key `backend.franka.address`"),
        ("address = \"172.16.0.2\"\nadress = \"172.16.0.2\"\n", "backend.franka.adress"),
        ("address = \"172.16.0.2\"\nlimits-share = 1.5\n", "key `backend.franka.limits-share`: got 1.5"),
        ("address = \"172.16.0.2\"\nstate-timeout = 0.1\n", "backend.franka.state-timeout"),
        ("address = \"172.16.0.2\"\nstate-timeout = \"1 ms\"\n", "key `backend.franka.state-timeout`: got 0.001 s"),
        ("address = \"172.16.0.2\"\njoint-impedance = [1, 2]\n", "key `backend.franka.joint-impedance"),
        (
            "address = \"172.16.0.2\"\njoint-impedance = [3000, 3000, 3000, 3000, 3000, 3000, 0]\n",
            "key `backend.franka.joint-impedance`: got 0 Nm/rad, expected above 0",
        ),
        (
            "address = \"172.16.0.2\"\n[backend.franka.load]\nmass = -1\ncom = [0, 0, 0]\n",
            "key `backend.franka.load.mass`: got -1 kg",
        ),
        (
            "address = \"172.16.0.2\"\n[backend.franka.load]\nmass = 20\ncom = [0, 0, 0]\n",
            "key `backend.franka.load.mass`: got 20 kg, expected 0 kg to 3 kg",
        ),
        (
            "address = \"172.16.0.2\"\n[backend.franka.load]\nmass = 2\ncom = [0, 0, 5]\n",
            "key `backend.franka.load.com`: got [0.0, 0.0, 5.0] m",
        ),
        (
            "address = \"172.16.0.2\"\n[backend.franka.load]\nmass = 2\ncom = [0, 0, 0]\ninertia = [0.03, 0, 0, 0.01, 0, 0.01]\n",
            "key `backend.franka.load.inertia`",
        ),
        (
            "address = \"172.16.0.2\"\n[backend.franka.socket]\nbusy-poll = 100000\n",
            "key `backend.franka.socket.busy-poll`",
        ),
        (
            "address = \"172.16.0.2\"\n[backend.franka.collision]\ncontact-torque = [20, 20, 18, 18, 16, 14, 0]\n",
            "key `backend.franka.collision.contact-torque`: got 0",
        ),
    ];
    for (more, expected) in cases {
        let message = refusal(&format!("{FRANKA}[backend.franka]\n{more}"), &[]);
        assert!(message.contains(expected), "`{message}` does not say `{expected}`");
    }
}

fn with_inclinometer(sets: &[&str]) -> Result<Job, String> {
    let text = "robot = \"panda\"\nmounting = \"upright\"\n[backend]\nkind = \"sim\"\narm = \"sim-panda\"\npace = \"wall-clock\"\n\
                [validation]\nmountings = [\"upright\"]\n\
                [inclinometer]\ninterface = \"can0\"\nnode = 10\nx = \"x\"\nz = \"z\"\n";
    parse(text, sets)
}

#[test]
fn an_inclinometer_has_defaults_and_every_bad_value_of_it_is_named() {
    let job = with_inclinometer(&[]).unwrap();
    let own = job.inclinometer.unwrap();
    assert_eq!((own.heartbeat, own.rate, own.bits, own.serial), (0.2, 50.0, 16, None));
    assert!((job.mounting_check.tolerance.to_degrees() - 5.0).abs() < 1e-9 && job.mounting_check.torques);
    let sensor = own.sensor("job.toml", job.mounting).unwrap();
    assert_eq!((sensor.node.period, sensor.node.heartbeat), (20, 200));
    with_inclinometer(&["inclinometer.x=[0.6, 0.8, 0.0]", "inclinometer.zero=[\"1 deg\", \"-1 deg\"]"]).unwrap();
    let cases = [
        ("inclinometer.interface=", "inclinometer.interface"),
        ("inclinometer.interface=../../etc", "inclinometer.interface"),
        ("inclinometer.node=0", "1 to 127"),
        ("inclinometer.node=128", "1 to 127"),
        ("inclinometer.rate=5 Hz", "10 Hz to 100 Hz"),
        ("inclinometer.rate=50", "with its unit"),
        ("inclinometer.heartbeat=1 ms", "20 ms to 5 s"),
        ("inclinometer.bits=24", "16 or 32"),
        ("inclinometer.x=up", "unit vector"),
        ("inclinometer.x=z", "right angles"),
        ("inclinometer.z=[0.0, 0.0, 2.0]", "right angles"),
        ("inclinometer.z=[0.0, 0.0, nan]", "right angles"),
        ("inclinometer.turn=1 deg", "deg/s"),
        ("inclinometer.turn=0 deg/s", "inclinometer.turn"),
        ("inclinometer.step=0 deg", "inclinometer.step"),
        ("inclinometer.on-loss=ignore", "refuse"),
        ("inclinometer.on-base-motion=ignore", "stop"),
        ("inclinometer.zero=[\"1 deg\"]", "inclinometer.zero"),
        ("inclinometer.colour=blue", "colour"),
        ("mounting-check.tolerance=0 deg", "0.5 deg to 90 deg"),
        ("mounting-check.tolerance=5", "with its unit"),
        ("backend.pace=fast", "simulated time"),
        ("validation.mountings=[\"wall\"]", "validation.mountings"),
        // Flat on the base of an arm on a wall the sensor sees nothing.
        ("mounting=wall", "bracket"),
    ];
    for (set, expected) in cases {
        let message = with_inclinometer(&[set]).expect_err(set);
        assert!(message.contains(expected), "{set}: no `{expected}` in {message}");
    }
}

#[test]
fn overrides_take_precedence_and_are_named_in_errors() {
    let sets =
        ["backend.pace=wall-clock", "excitation.period=12 s", "backend.seed=7", "validation.mountings=[\"wall\"]"];
    let job = parse(LEAST, &sets).unwrap();
    assert_eq!((job.backend.pace, job.backend.seed, job.excitation.period), (Pace::WallClock, 7, 12.0));
    assert_eq!(job.validation.mountings, [Mounting::WALL]);
    assert_eq!(parse(LEAST, &["backend.seed=7", "backend.seed=8"]).unwrap().backend.seed, 8);
    let tilted = parse(LEAST, &["mounting.rho=30 deg", "mounting.phi=0 deg"]).unwrap();
    assert_eq!(tilted.mounting.rho, 30_f64.to_radians());

    let cases = [
        ("excitation.periods=0", "--set excitation.periods=0: key `excitation.periods` (over conf/job.toml): got 0"),
        ("excitation.perods=3", "--set excitation.perods=3: key `excitation.perods` (over conf/job.toml)"),
        ("backend.pace=slow", "--set backend.pace=slow: key `backend.pace` (over conf/job.toml): got `\"slow\"`"),
        ("excitation.period=10", "a duration with its unit"),
        ("nonsense", "--set nonsense: option: got `nonsense`, expected key.path=value"),
        ("a..b=1", "expected key.path=value"),
        ("backend.seed.deep=1", "--set backend.seed.deep=1"),
    ];
    for (set, expected) in cases {
        let message = refusal(LEAST, &[set]);
        assert!(message.starts_with("--set ") && message.contains(expected), "`{message}` does not say `{expected}`");
    }
    // An override is not blamed for what the file got wrong.
    let message = refusal(&format!("{LEAST}[limits]\nsped = 1\n"), &["backend.seed=7"]);
    assert!(message.starts_with("conf/job.toml: line 7, key `limits.sped`"), "{message}");
    let message = refusal(&format!("{LEAST}[limits]\nspeed = 2\n"), &["backend.seed=7"]);
    assert!(message.starts_with("conf/job.toml: key `limits.speed`"), "{message}");
}

#[test]
fn files_are_found_beside_the_configuration() {
    let text = LEAST.replace("sim-panda", "arms/mine.toml") + "[excitation]\nplan = \"plan.toml\"\n";
    let job = parse(&text, &[]).unwrap();
    assert_eq!(job.backend.arm, Some(Resource::File("conf/arms/mine.toml".into())));
    assert_eq!(job.excitation.plan, Some("conf/plan.toml".into()));
    let lost = job.backend.arm.unwrap().read("backend.arm", &[]).unwrap_err().to_string();
    assert!(lost.contains("conf/arms/mine.toml") && lost.contains("backend.arm"), "{lost}");
    let unknown = Resource::BuiltIn("sim-pnda".into()).read("backend.arm", &[("sim-panda", "")]).unwrap_err();
    assert!(unknown.to_string().contains("got `sim-pnda`, expected the path of a .toml file or one of sim-panda"));
    assert!(Job::load(Path::new("no/such.toml"), &[]).unwrap_err().to_string().starts_with("no/such.toml: file: got "));
}

#[test]
fn limit_overrides_only_tighten_and_ratios_do_not_affect_the_guard() {
    let eight = |value: f64| [value; plumbline_core::MAX_JOINTS];
    let robot = plumbline_core::Limits {
        q_min: eight(-2.0),
        q_max: eight(2.0),
        dq: eight(2.0),
        ddq: eight(10.0),
        jerk: eight(5000.0),
        tau: eight(87.0),
        dtau: eight(1000.0),
    };
    let job =
        parse(&format!("{LEAST}[limits]\nspeed = 0.5\nmargin = \"0.1 rad\"\noverride.dq = [1.0, 2.0]\n"), &[]).unwrap();
    let (guard, margins) = (job.guard_limits(&robot, 2).unwrap(), job.margins());
    assert_eq!((guard.dq[0], guard.dq[1], guard.q_max[0]), (1.0, 2.0, 2.0));
    assert_eq!((margins.velocity, margins.position), (0.5, 0.1));
    let refused = |list: &str| {
        let job = parse(&format!("{LEAST}[limits]\noverride.{list}\n"), &[]).unwrap();
        job.guard_limits(&robot, 2).unwrap_err().to_string()
    };
    assert!(refused("dq = [1.0]").contains("key `limits.override.dq`: got 1 values, expected 2"));
    assert!(refused("dq = [1.0, 2.5]").contains("key `limits.override.dq[1]`: got 2.5"));
    assert!(refused("q-min = [-3.0, 0.0]").contains("key `limits.override.q-min[0]`: got -3"));
    assert!(refused("tau = [nan, 1.0]").contains("key `limits.override.tau[0]`: got NaN"));
    assert!(refused("q-min = [0.0, 2.0]").contains("less than q-max"));
}
