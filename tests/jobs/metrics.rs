//! The metrics endpoint: scraped during a job and at a daemon that serves a model; garbage, slow clients, a port that is taken.

use plumbline_ipc::{Client, Request, Response, RobotId};
use plumbline_testkit::job::*;
use std::collections::HashMap;
use std::io::{Read, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};

fn free_port() -> u16 {
    TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap().local_addr().unwrap().port()
}

fn connect(port: u16) -> Option<TcpStream> {
    let stream = TcpStream::connect((Ipv4Addr::LOCALHOST, port)).ok()?;
    stream.set_read_timeout(Some(TIMEOUT)).unwrap();
    Some(stream)
}

/// Status and body of the response to a request; `None` where nobody listens, or the connection is cut.
fn ask(port: u16, request: &[u8]) -> Option<(u16, String)> {
    let mut stream = connect(port)?;
    stream.write_all(request).ok()?;
    let mut response = String::new();
    stream.read_to_string(&mut response).ok()?;
    let (head, body) = response.split_once("\r\n\r\n")?;
    Some((head.split(' ').nth(1)?.parse().ok()?, body.to_string()))
}

/// Values of a page by name and labels, without the label of the robot.
fn scrape(port: u16, id: &str) -> Option<HashMap<String, f64>> {
    let (status, body) = ask(port, b"GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n")?;
    let robot = format!("robot=\"{id}\"");
    let row = |line: &str| {
        let (name, value) = line.rsplit_once(' ').unwrap();
        assert!(name.starts_with("plumbline_") && name.contains(&robot), "{line}");
        let name = name.replace(&format!("{robot},"), "").replace(&format!("{{{robot}}}"), "");
        (name, value.parse().unwrap_or_else(|_| panic!("{line}")))
    };
    (status == 200).then(|| body.lines().filter(|line| !line.starts_with('#')).map(row).collect())
}

fn joints(page: &HashMap<String, f64>, name: &str) -> usize {
    (1..=7).filter(|j| page.get(&format!("{name}{{joint=\"{j}\"}}")).is_some_and(|value| value.is_finite())).count()
}

#[test]
fn a_job_and_a_daemon_are_scraped_and_other_clients_change_nothing() {
    let (place, port) = (Place::new("metrics"), free_port());
    let set = format!("serve.metrics-port={port}");

    // A job in simulated time: the page while it is driven.
    let running = Running::start(place.job("run", &short(&[&set])));
    let driven = wait_for("a page of the job", || {
        scrape(port, &place.id).filter(|page| page["plumbline_state{state=\"driving\"}"] == 1.0)
    });
    assert!(driven["plumbline_samples_missed_total{kind=\"lost\"}"] == 0.0, "{driven:?}");
    // No deadlines, so no wake-up latency.
    assert!(!driven.keys().any(|name| name.contains("wake_up")), "{driven:?}");
    running.end().expect_code(0);
    assert!(scrape(port, &place.id).is_none(), "the endpoint has ended with the daemon");

    // A daemon at the pace of the clock, which serves the model of that job.
    let sets = [&short(&LONG_ON_CLOCK)[..], &[set.as_str()]].concat();
    let daemon = place.daemon(&sets);
    let mut client = Client::connect(&RobotId::parse("test", "robot", &place.id).unwrap(), TIMEOUT).unwrap();
    let toml = std::fs::read_to_string(place.out().join("model.toml")).unwrap();
    let answer = client.send(&Request::OfferModel { toml }, TIMEOUT).unwrap();
    let Response::ModelAccepted { model } = answer else { panic!("{answer:?}") };
    place.command("start").expect_code(0);
    place.await_motion();
    let external = "plumbline_external_torque_newton_metres";
    // At a start the model is withdrawn until the arm has told its mounting: a page before that is none of the motion.
    let valid = format!("plumbline_model_info{{model=\"{model:016x}\",validity=\"valid\"}}");
    let page = wait_for("a page with every figure", || {
        scrape(port, &place.id).filter(|page| {
            page["plumbline_state{state=\"driving\"}"] == 1.0
                && page["plumbline_cycles_total"] > 0.0
                && page.get(&valid) == Some(&1.0)
                && joints(page, external) == 7
        })
    });
    for name in ["residual", "noise_floor", "contact_threshold"] {
        assert_eq!(joints(&page, &format!("plumbline_{name}_newton_metres")), 7, "{name}: {page:?}");
    }
    let wake_up =
        ["0.5", "0.99", "0.999", "1"].map(|q| page[&format!("plumbline_wake_up_seconds{{quantile=\"{q}\"}}")]);
    assert!(wake_up[0] > 0.0 && wake_up.windows(2).all(|pair| pair[0] <= pair[1]), "{wake_up:?}");
    for counter in ["plumbline_cycles_total", "plumbline_model_age_seconds"] {
        let grows =
            || scrape(port, &place.id).filter(|later| later.get(counter).is_some_and(|now| *now > page[counter]));
        wait_for(counter, grows);
    }

    // Whoever sends no request, half of one, or another one.
    for (request, status) in [
        (&b"\x16\x03\x01 nonsense\r\n\r\n"[..], 400),
        (b"GET / HTTP/1.1\r\n\r\n", 404),
        (b"PUT /metrics HTTP/1.1\r\n\r\n", 405),
    ] {
        assert_eq!(ask(port, request).unwrap().0, status, "{request:?}");
    }
    let mut slow: Vec<TcpStream> = (0..24).map(|_| connect(port).unwrap()).collect();
    slow.iter_mut().for_each(|stream| stream.write_all(b"GET /met").unwrap());
    assert!(scrape(port, &place.id).is_some_and(|page| page["plumbline_state{state=\"driving\"}"] == 1.0));
    for stream in &mut slow {
        assert_eq!(stream.read(&mut [0; 16]).unwrap_or(0), 0, "a client that sends no request in time is cut off");
    }

    // Another daemon at the same port: bad input, before anything moves.
    let other = Place::new("metrics-other");
    for subcommand in ["daemon", "run"] {
        let refused = Done::of(other.job(subcommand, &sets)).expect_code(2);
        let parts = [WALL, "key `serve.metrics-port`", &format!("got {port}, which another program listens on")];
        assert!(parts.iter().all(|part| refused.err.contains(part)), "{}", refused.output());
    }
    place.quit(daemon);
    assert!(TcpListener::bind((Ipv4Addr::LOCALHOST, port)).is_ok(), "the port is free again");
}

#[test]
fn a_port_that_is_none_is_refused() {
    let place = Place::new("metrics-none");
    for port in ["0", "65536", "-1"] {
        let done = Done::of(place.job("daemon", &[&format!("serve.metrics-port={port}")])).expect_code(2);
        let parts =
            [format!("--set serve.metrics-port={port}"), "key `serve.metrics-port`".into(), "1 to 65535".into()];
        assert!(parts.iter().all(|part| done.err.contains(part)), "{}", done.output());
    }
}
