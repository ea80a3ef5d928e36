//! The parameters of a torque model and the columns that they multiply.

/// One column of a regressor, that is, one parameter of the model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Column {
    /// Unique in the model, in ASCII: `Lxx2`, `fv3`, `offset1`.
    pub name: String,
    /// Symbol in texts: `LxxR2`, `fv3`.
    pub symbol: String,
    /// Joint or link it belongs to, counted from 1.
    pub joint: usize,
    /// Unit of the parameter.
    pub unit: &'static str,
    /// Standard parameters that it combines, in the paper's convention: `Lzz1 + Lyy2`.
    pub expression: String,
}

/// One parameter of a model.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// The column that it multiplies.
    pub column: Column,
    /// Its value, in the column's unit.
    pub value: f64,
    /// Its standard deviation where known, in the column's unit.
    pub std: Option<f64>,
}
