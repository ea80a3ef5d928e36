//! A force at a point of a link that keeps its direction: its sizes, direction and point together.
//!
//!   tau_j(t) = s(t) d' (j_j(t) + R(t) p x z_j(t))
//!
//! is linear in each of `s`, `d` and `p` alone, and taking turns creeps along the valley of those that explain nearly as much.
//! Levenberg and Marquardt's method follows it.

use super::course::{Course, Normal, SETTLED_RATIO, ridged};
use super::{Act, Data, Fitted, MAX_LEVER_M};
use nalgebra::{DMatrix, DVector, Vector3};

/// Most steps.
const MAX_STEPS: usize = 60;
/// First weight of the damping, and the largest.
const DAMPING: [f64; 2] = [1e-3, 1e6];

/// A force that keeps its direction.
#[derive(Clone)]
struct Push {
    sizes: DVector<f64>,
    direction: Vector3<f64>,
    point: Vector3<f64>,
}

impl Data<'_> {
    /// The force that keeps its direction on a link and explains most, from one at a point.
    pub(super) fn settled(&self, start: &Fitted) -> Option<Fitted> {
        let (sizes, direction) = start.course.line()?;
        let mut push = Push {
            sizes: sizes.clone(),
            direction: direction.fixed_rows::<3>(0).into_owned(),
            point: start.act.point()?,
        };
        let (mut normal, mut rss) = self.normal_of(start.link, &push);
        let mut damping = DAMPING[0];
        for _ in 0..MAX_STEPS {
            let mut g = normal.g.clone();
            (0..g.nrows()).for_each(|k| g[(k, k)] *= 1.0 + damping);
            let Some(step) = ridged(g).map(|factor| factor.solve(&normal.b)) else { break };
            let next = push.after(&step);
            let (own, left) = self.normal_of(start.link, &next);
            if left < rss {
                let settled = rss - left < SETTLED_RATIO * left;
                (push, normal, rss) = (next, own, left);
                damping = (0.3 * damping).max(1e-9);
                if settled {
                    break;
                }
            } else {
                damping *= 5.0;
                if damping > DAMPING[1] {
                    break;
                }
            }
        }
        let course = Course::along(push.sizes, DVector::from_column_slice(push.direction.as_slice()), rss);
        let parameters = start.parameters;
        let explained = self.explained(rss, parameters);
        Some(Fitted { link: start.link, act: Act::Push(push.point), course, parameters, explained })
    }

    /// Normal equations of a step from here, and the sum of squares that is left.
    fn normal_of(&self, link: usize, push: &Push) -> (Normal, f64) {
        let knots = push.sizes.len();
        let columns = self.columns(link, Act::Push(push.point));
        let (mut normal, mut rss) = (Normal::of(knots + 6), 0.0);
        for (joint, columns) in columns.iter().enumerate() {
            let mut design = DMatrix::zeros(self.rows.len(), knots + 6);
            let mut rest = self.torques.tau.column(joint).into_owned();
            for (block, &(knot, weight)) in self.torques.hats.iter().enumerate().filter(|_| joint <= link) {
                let along: f64 = (0..3).map(|c| columns[(block, c)] * push.direction[c]).sum();
                let size = weight * push.sizes[knot] + (1.0 - weight) * push.sizes[knot + 1];
                rest[block] -= along * size;
                design[(block, knot)] = weight * along;
                design[(block, knot + 1)] = (1.0 - weight) * along;
                let frame = &self.frames[block][link];
                let [_, axis] = self.transposed(&self.frames[block], link, joint, frame.origin);
                // z . (R p x d) = p . R' (d x z).
                let by_point = frame.rotation.transpose() * push.direction.cross(&axis) * size;
                for c in 0..3 {
                    design[(block, knots + c)] = columns[(block, c)] * size;
                    design[(block, knots + 3 + c)] = by_point[c];
                }
            }
            normal.add(&design, &self.torques.weights[joint], &rest);
            rss += rest.dot(&(&self.torques.weights[joint] * &rest));
        }
        (normal, rss)
    }
}

impl Push {
    fn after(&self, step: &DVector<f64>) -> Self {
        let knots = self.sizes.len();
        let direction = self.direction + step.fixed_rows::<3>(knots);
        let length = direction.norm().max(1e-12);
        let point = self.point + step.fixed_rows::<3>(knots + 3);
        let far = (point.norm() / MAX_LEVER_M).max(1.0);
        let sizes = (&self.sizes + step.rows(0, knots)) * length;
        Push { sizes, direction: direction / length, point: point / far }
    }
}
