//! Names of the inertial parameters, and the standard parameters that a base parameter combines, in the paper's convention
//! (Tables I and II): `LzzR1 = Lzz1 + Lyy2`, `lyR1 = ly1 + lz2`.

use super::base::Reduction;
use super::parameter::Column;
use super::regressor::LINK_COLUMNS;

/// Standard parameters of a link in their order (paper eq. 5).
const STEMS: [&str; LINK_COLUMNS] = ["Lxx", "Lxy", "Lxz", "Lyy", "Lyz", "Lzz", "lx", "ly", "lz", "m"];

/// Relative difference below which two coefficients are equal: both are sums of products of the arm's lengths.
const SAME: f64 = 1e-9;

/// Name of a standard parameter, `Lxx2`; `slot = 10 * link + position`.
pub fn parameter_name(slot: usize) -> String {
    format!("{}{}", STEMS[slot % LINK_COLUMNS], slot / LINK_COLUMNS + 1)
}

/// Symbol of the base parameter that takes a slot, `LxxR2`. The paper writes the R ("regrouped") for all of them.
pub fn symbol(slot: usize) -> String {
    format!("{}R{}", STEMS[slot % LINK_COLUMNS], slot / LINK_COLUMNS + 1)
}

/// Unit of a standard parameter: `kg m2`, `kg m` or `kg`.
pub fn unit(slot: usize) -> &'static str {
    match slot % LINK_COLUMNS {
        0..=5 => "kg m2",
        6..=8 => "kg m",
        _ => "kg",
    }
}

/// The base parameters of a reduction as columns of a model.
pub fn base_columns(reduction: &Reduction) -> Vec<Column> {
    let column = |(row, &slot): (usize, &usize)| Column {
        name: parameter_name(slot),
        symbol: symbol(slot),
        joint: slot / LINK_COLUMNS + 1,
        unit: unit(slot),
        expression: expression(reduction, row),
    };
    reduction.independent().iter().enumerate().map(column).collect()
}

/// Standard parameters of base parameter `row`: its own first, the others by link, those with one coefficient together,
/// coefficients in m and m2 to six digits: `Lxx2 - Lyy2 + Lyy3 + 0.632 lz3 + 0.099856 m3 + 0.106662 (m4 + m5 + m6 + m7)`.
pub fn expression(reduction: &Reduction, row: usize) -> String {
    let own = reduction.independent()[row];
    // Groups of one coefficient, in the order of their first member.
    let mut groups: Vec<(f64, Vec<usize>)> = vec![(1.0, vec![own])];
    for (slot, &coefficient) in reduction.regroup().row(row).iter().enumerate() {
        if slot == own || coefficient == 0.0 {
            continue;
        }
        let same = |group: &&mut (f64, Vec<usize>)| (group.0 - coefficient).abs() <= SAME * coefficient.abs();
        match groups.iter_mut().skip(1).filter(|group| group.0.abs() != 1.0).find(same) {
            Some(group) => group.1.push(slot),
            None => groups.push((coefficient, vec![slot])),
        }
    }
    let mut text = String::new();
    for (index, (coefficient, slots)) in groups.iter().enumerate() {
        let sign = if *coefficient < 0.0 { "-" } else { "+" };
        match (index, sign) {
            (0, "+") => {}
            (0, _) => text.push('-'),
            _ => text.push_str(&format!(" {sign} ")),
        }
        if coefficient.abs() != 1.0 {
            text.push_str(&format!("{} ", six_digits(coefficient.abs())));
        }
        let names = slots.iter().map(|&slot| parameter_name(slot)).collect::<Vec<_>>().join(" + ");
        text.push_str(&if slots.len() > 1 { format!("({names})") } else { names });
    }
    text
}

/// Six significant digits without trailing zeros.
pub(super) fn six_digits(value: f64) -> String {
    let decimals = (5 - value.abs().log10().floor() as i32).max(0) as usize;
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_string() } else { text }
}
