//! Straight-line C from sums of products, with what is known when it is written left out.

use std::collections::BTreeSet;

/// A value in the program: known now, or a variable (with a sign).
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// Known now.
    Known(f64),
    /// A variable, negated where the flag says so.
    Variable(String, bool),
}

pub const ZERO: Value = Value::Known(0.0);

impl Value {
    pub fn input(name: impl Into<String>) -> Value {
        Value::Variable(name.into(), false)
    }

    pub fn negated(&self) -> Value {
        match self {
            Value::Known(value) => Value::Known(-value),
            Value::Variable(name, negative) => Value::Variable(name.clone(), !negative),
        }
    }

    fn is_zero(&self) -> bool {
        *self == ZERO
    }

    /// Text without the sign, and the sign.
    fn text(&self) -> (String, bool) {
        match self {
            Value::Known(value) => (format!("{:?}", value.abs()), *value < 0.0),
            Value::Variable(name, negative) => (name.clone(), *negative),
        }
    }
}

/// A program in the making: one assignment after another.
#[derive(Default)]
pub struct Program {
    lines: Vec<(String, String)>,
}

impl Program {
    /// A variable of that name for an expression of the caller's.
    ///
    /// The same name stands for the same expression, wherever it is asked for.
    pub fn named(&mut self, name: String, expression: String) -> Value {
        if !self.lines.iter().any(|(before, _)| *before == name) {
            self.lines.push((name.clone(), expression));
        }
        Value::input(name)
    }

    /// A name that no variable has, with this letter in front.
    pub fn fresh(&self, letter: &str) -> String {
        format!("{letter}{}", self.lines.len())
    }

    /// `sum of a b` over the pairs. Products with zero vanish, those of two known numbers are taken now, a single factor of one is itself.
    pub fn sum(&mut self, pairs: &[(Value, Value)]) -> Value {
        let mut known = 0.0;
        let mut products: Vec<(String, bool)> = Vec::new();
        let mut single = None;
        for (a, b) in pairs {
            match (a, b) {
                (Value::Known(a), Value::Known(b)) => known += a * b,
                _ if a.is_zero() || b.is_zero() => {}
                (Value::Known(one), other) | (other, Value::Known(one)) if one.abs() == 1.0 => {
                    let value = if *one < 0.0 { other.negated() } else { other.clone() };
                    products.push(value.text());
                    single = Some(value);
                }
                _ => {
                    let ((a, minus_a), (b, minus_b)) = (a.text(), b.text());
                    products.push((format!("{a}*{b}"), minus_a != minus_b));
                    single = None;
                }
            }
        }
        match (products.len(), single) {
            (0, _) => return Value::Known(known),
            (1, Some(value)) if known == 0.0 => return value,
            _ => {}
        }
        if known != 0.0 {
            products.push(Value::Known(known).text());
        }
        let mut expression = String::new();
        for (index, (product, minus)) in products.iter().enumerate() {
            expression += match (index, minus) {
                (0, false) => "",
                (0, true) => "-",
                (_, false) => " + ",
                (_, true) => " - ",
            };
            expression += product;
        }
        let name = self.fresh("t");
        self.named(name, expression)
    }

    pub fn add(&mut self, a: &Value, b: &Value) -> Value {
        let one = Value::Known(1.0);
        self.sum(&[(a.clone(), one.clone()), (b.clone(), one)])
    }

    pub fn product(&mut self, a: &Value, b: &Value) -> Value {
        self.sum(&[(a.clone(), b.clone())])
    }

    /// The assignments that `outputs` need, in order, each a line of C.
    pub fn lines(&self, outputs: &[Value]) -> String {
        let mut needed: BTreeSet<&str> = BTreeSet::new();
        for output in outputs {
            if let Value::Variable(name, _) = output {
                needed.insert(name);
            }
        }
        let mut kept = Vec::new();
        for (name, expression) in self.lines.iter().rev() {
            if needed.contains(name.as_str()) {
                needed.extend(
                    expression.split(|c: char| !c.is_alphanumeric() && c != '_').filter(|word| !word.is_empty()),
                );
                kept.push(format!("    const double {name} = {expression};\n"));
            }
        }
        kept.reverse();
        kept.concat()
    }
}

pub fn expression(value: &Value) -> String {
    let (text, minus) = value.text();
    if minus { format!("-{text}") } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_known_is_not_computed_later() {
        let mut program = Program::default();
        let (x, y) = (Value::input("x"), Value::input("y"));
        assert_eq!(program.sum(&[(ZERO, x.clone()), (Value::Known(2.0), Value::Known(3.0))]), Value::Known(6.0));
        assert_eq!(program.sum(&[(Value::Known(-1.0), x.clone()), (y.clone(), ZERO)]), x.negated());
        assert_eq!(program.lines(&[]), "");
        let sum =
            program.sum(&[(x.negated(), y.clone()), (Value::Known(0.5), y), (Value::Known(-2.0), Value::Known(1.0))]);
        let unused = program.product(&x, &sum);
        assert_ne!(unused, sum);
        assert_eq!(program.lines(&[sum]), "    const double t0 = -x*y + 0.5*y - 2.0;\n");
    }
}
