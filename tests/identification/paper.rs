//! The paper, reproduced: its tables and figures in simulation, and docs/results/paper.md, which shows them.

use plumbline_identify::Settings;
use plumbline_model::{Mounting, Robot, rnea};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::Path;

/// Value of an expression of standard parameters such as `Lxx2 - Lyy2 + 0.632 lz3 + 0.106662 (m4 + m5)`.
fn evaluate(expression: &str, of: &impl Fn(&str) -> f64) -> f64 {
    let (mut sum, mut sign, mut factor, mut group) = (0.0, 1.0, 1.0, 1.0);
    for word in expression.split(' ') {
        match word {
            "+" => sign = 1.0,
            "-" => sign = -1.0,
            number if number.parse::<f64>().is_ok() => factor = number.parse().unwrap(),
            name => {
                // Inside brackets the coefficient stays; the sign before the bracket, too.
                if let Some(first) = name.strip_prefix('(') {
                    group = sign * factor;
                    sum += group * of(first);
                    (sign, factor) = (1.0, f64::NAN);
                } else if factor.is_nan() {
                    sum += sign * group * of(name.trim_end_matches(')'));
                } else {
                    sum += sign * factor * of(name);
                }
                if name.ends_with(')') || !factor.is_nan() {
                    factor = 1.0;
                }
            }
        }
    }
    sum
}

/// Table I. The printed expressions mean something: put into Newton-Euler in the slots of their names, the 45 inertial ones give the
/// torque of the 70 standard parameters they were computed from, in any mounting (six printed digits allow 1e-5).
#[test]
fn table_1_regroups_70_parameters_to_45_and_14_of_friction() {
    let rows = plumbline_testkit::paper::experiment::table_1();
    assert_eq!(rows.len(), 59);
    assert_eq!(rows.iter().filter(|row| row.vertical.is_some()).count(), 57);
    let missing: Vec<&str> = rows.iter().filter(|row| row.vertical.is_none()).map(|row| row.symbol.as_str()).collect();
    assert_eq!(missing, ["lxR1", "lyR1"]);
    let of = |symbol: &str| rows.iter().find(|row| row.symbol == symbol).unwrap().generalized.as_str();
    // The rows that the paper prints (k21 = 0.316^2 + 0.0825^2, k22 = 0.316^2, k23 = 2 * 0.316).
    assert_eq!(of("LzzR1"), "Lzz1 + Lyy2");
    assert_eq!(of("LxxR2"), "Lxx2 - Lyy2 + Lyy3 + 0.632 lz3 + 0.099856 m3 + 0.106662 (m4 + m5 + m6 + m7)");
    assert_eq!((of("lxR1"), of("lyR1"), of("fc7")), ("lx1", "ly1 + lz2", "fc7"));

    let stems = ["Lxx", "Lxy", "Lxz", "Lyy", "Lyz", "Lzz", "lx", "ly", "lz", "m"];
    let chain = Robot::load("panda", None).unwrap().chain;
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for _ in 0..20 {
        let delta: Vec<[f64; 10]> = (0..7).map(|_| std::array::from_fn(|_| rng.random_range(-1.0..1.0))).collect();
        let slot = |name: &str| {
            let (stem, link) = name.split_at(name.len() - 1);
            (link.parse::<usize>().unwrap() - 1, stems.iter().position(|known| *known == stem).unwrap())
        };
        let value = |name: &str| {
            let (link, position) = slot(name);
            delta[link][position]
        };
        let mut beta = vec![[0.0; 10]; 7];
        for row in rows.iter().filter(|row| !row.symbol.starts_with('f')) {
            let (link, position) = slot(&row.symbol.replace('R', ""));
            beta[link][position] = evaluate(&row.generalized, &value);
        }
        let mut draw = |span: f64| -> [f64; 7] { std::array::from_fn(|_| rng.random_range(-span..span)) };
        let (q, dq, ddq) = (draw(3.0), draw(2.0), draw(4.0));
        let gravity = Mounting { rho: draw(3.1)[0], phi: draw(3.1)[0] }.gravity();
        let (mut all, mut regrouped) = ([0.0; 7], [0.0; 7]);
        rnea(&chain, &delta, &gravity, &q, &dq, &ddq, &mut all);
        rnea(&chain, &beta, &gravity, &q, &dq, &ddq, &mut regrouped);
        for (a, b) in all.iter().zip(regrouped) {
            assert!((a - b).abs() < 1e-4 * all[0].abs().max(10.0), "{all:?} {regrouped:?}");
        }
    }
}

/// Table II to the printed digits, and Figs. 3 and 4.
#[test]
fn table_2_and_figures_3_and_4_of_the_two_dof_arm() {
    let printed = [
        ("Lzz1", 0.320, Some(0.320)),
        ("lx1", 0.800, None),
        ("ly1", 1.100, None),
        ("Lxx2", 1.590, Some(1.590)),
        ("Lxy2", 0.210, Some(0.210)),
        ("Lxz2", -0.030, Some(-0.030)),
        ("Lyz2", 0.210, Some(0.210)),
        ("Lzz2", 1.660, Some(1.660)),
        ("lx2", 0.300, Some(0.300)),
        ("ly2", -2.100, Some(-2.100)),
    ];
    let two = plumbline_testkit::paper::experiment::two_dof();
    assert_eq!((two.horizontal.len(), two.vertical.len()), (10, 8));
    for (name, horizontal, vertical) in printed {
        let found = two.horizontal.iter().find(|row| row.0 == name).unwrap().3;
        assert!((found - horizontal).abs() < 1e-6, "{name}: {found}, printed {horizontal}");
        let found = two.vertical.iter().find(|row| row.0 == name).map(|row| row.1);
        assert_eq!(found.is_some(), vertical.is_some(), "{name}");
        assert!(found.zip(vertical).is_none_or(|(found, printed)| (found - printed).abs() < 1e-6), "{name}: {found:?}");
    }

    let [upright, wall] = two.figures.as_slice() else { panic!("two figures") };
    // Fig. 3: upright both models are right. Fig. 4: on the wall the V-BAM model misses some 10.9 Nm in joint 1 and nothing in joint 2.
    assert!(
        upright.rms.iter().flatten().chain(&wall.rms[0]).all(|&rms| rms < 1e-6),
        "{:?} {:?}",
        upright.rms,
        wall.rms
    );
    assert!(wall.rms[1][1] < 1e-6, "{:?}", wall.rms);
    // The missing term's amplitude is g sqrt(0.8^2 + 1.1^2) = 13.3 Nm; the paper's 10.9 Nm is one random trajectory of many.
    let (least, most) = (two.misses[0], two.misses[two.misses.len() - 1]);
    assert!(least > 4.0 && least < 10.9 && most > 10.9 && most < 13.35, "{:.1?}", two.misses);
}

/// Tables III to V, Figs. 7 and 8: an arm with the parameters of Table III, noise of the size of the errors in Tables IV and V, the paper's
/// processing. The parameters come back within their standard deviations and add nothing to the noise in either mounting.
#[test]
fn tables_3_to_5_of_the_panda_with_noise_as_in_the_paper() {
    let panda = plumbline_testkit::paper::experiment::panda(&Settings::paper());
    assert_eq!((panda.found.beta.len(), panda.found.rank), (59, 59));
    let z: Vec<f64> = (panda.found.beta.iter().zip(&panda.truth).zip(&panda.found.std))
        .map(|((beta, truth), std)| (beta - truth) / std.expect("59 parameters are determined on the wall"))
        .collect();
    let rms = (z.iter().map(|z| z * z).sum::<f64>() / 59.0).sqrt();
    assert!((0.7..1.4).contains(&rms) && z.iter().all(|z| z.abs() < 4.5), "{rms:.2}: {z:.1?}");
    for (table, noise) in [
        (&panda.table_4, plumbline_testkit::paper::experiment::TABLE_4_MEAN),
        (&panda.table_5, plumbline_testkit::paper::experiment::TABLE_5_MEAN),
    ] {
        assert_eq!(table.len(), 5);
        for (found, noise) in table.iter().flat_map(|rms| rms.iter().zip(noise)) {
            assert!((0.97..1.06).contains(&(found / noise)), "{found} Nm in a noise of {noise} Nm");
        }
    }
    // Figs. 7 and 8 show trajectory 3 of both tables: the drawn curves are as far apart as the tables say, and the torques are worth seeing.
    let names: Vec<&str> = panda.shown.iter().map(|run| run.mounting).collect();
    assert_eq!(names, ["H-BAM", "V-BAM"]);
    for (run, table) in panda.shown.iter().zip([&panda.table_4, &panda.table_5]) {
        assert_eq!(run.rms, table[2]);
        for (j, rms) in run.rms.iter().enumerate() {
            let (measured, estimated) = (run.measured.column(j), run.estimated.column(j));
            let apart = (measured - estimated).norm() / (run.t.len() as f64).sqrt();
            assert!((apart / rms - 1.0).abs() < 0.02, "joint {}: {apart} Nm drawn, {rms} Nm told", j + 1);
            let spread = estimated.max() - estimated.min();
            assert!(spread > 3.0 * rms, "joint {}: {spread} Nm", j + 1);
        }
    }
}

/// Fig. 6: the optimised excitation stays in the box and out of the sphere.
#[test]
fn figure_6_stays_in_the_workspace() {
    let (path, space) = plumbline_testkit::paper::experiment::workspace();
    let spread = |axis: usize| {
        let values = path.iter().map(|at| at[axis]);
        values.clone().fold(f64::MIN, f64::max) - values.fold(f64::MAX, f64::min)
    };
    assert!((0..3).all(|axis| spread(axis) > 0.3), "an excitation that hardly moves");
    for at in &path {
        assert!((0..3).all(|axis| (space.box_min[axis]..=space.box_max[axis]).contains(&at[axis])), "{at:?}");
        assert!(at.iter().map(|x| x * x).sum::<f64>().sqrt() >= space.base_radius, "{at:?}");
    }
}

/// Every figure is drawn, is on the page, and its file is there.
#[test]
fn figures_are_drawn_and_shown() {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs");
    let page = plumbline_testkit::page::read("docs/results/paper.md");
    for (name, svg) in plumbline_testkit::paper::figures::all() {
        assert!(svg.starts_with("<svg") && svg.matches("<polyline").count() >= 3, "{name}");
        assert!(page.contains(&format!("(../figures/{name})")) && docs.join("figures").join(name).is_file(), "{name}");
    }
}

/// docs/results/paper.md shows what the program computes; `cargo run --release --example paper` writes it.
#[test]
fn the_page_matches_the_program() {
    let page = plumbline_testkit::page::read("docs/results/paper.md");
    for (name, content) in plumbline_testkit::paper::tables::all() {
        assert!(
            page.contains(&format!("<!-- {name} -->\n{content}<!-- end -->")),
            "block {name} of docs/results/paper.md is old"
        );
    }
}
