//! CSV file of one run: columns by name, every cell checked.

use super::Format;
use super::layout::{Columns, Layout, Torque};
use plumbline_core::BadInput;
use std::path::Path;

pub(super) fn read(path: &Path, torque: Torque) -> Result<Columns, BadInput> {
    let file = path.display().to_string();
    let bytes = std::fs::read(path).map_err(|error| BadInput::new(&file, "file", error, "a readable CSV file"))?;
    parse(&file, &bytes, torque)
}

/// Parses CSV text; `file` is only named in errors.
pub(super) fn parse(file: &str, bytes: &[u8], torque: Torque) -> Result<Columns, BadInput> {
    let bytes = text_of(file, bytes)?;
    let mut reader = ::csv::ReaderBuilder::new().trim(::csv::Trim::All).flexible(true).from_reader(bytes);
    let header: Vec<String> = match reader.headers() {
        Ok(header) => header.iter().map(str::to_string).collect(),
        Err(error) => return Err(BadInput::new(file, "line 1", error, "a header row of column names")),
    };
    let layout = Layout::of(file, &header, torque, Format::Csv)?;
    let columns = cells(file, &header, &mut reader)?;
    layout.take(file, header, columns, Format::Csv)
}

/// The text of a CSV file, without the mark that some programs write before it. Refuses files of another form by its name.
pub(crate) fn text_of<'b>(file: &str, bytes: &'b [u8]) -> Result<&'b [u8], BadInput> {
    let refused = |found: &str, expected: &str| Err(BadInput::new(file, "line 1", found, expected));
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    if bytes.iter().all(u8::is_ascii_whitespace) {
        return refused("an empty file", "a header row `t,q1,..,tau1,..`, then one row per sample; no column `t`");
    }
    let first = bytes.split(|byte| *byte == b'\n').next().unwrap_or_default();
    if bytes.starts_with(b"\xff\xfe") || bytes.starts_with(b"\xfe\xff") || first.contains(&0) {
        return refused("text in UTF-16, or no text", "a CSV file in UTF-8 (save it again as UTF-8)");
    }
    let count = |separator: u8| first.iter().filter(|byte| **byte == separator).count();
    for (separator, name) in [(b';', "semicolons"), (b'\t', "tabs"), (b' ', "blanks"), (b'|', "bars")] {
        if count(b',') == 0 && count(separator) > 1 {
            return refused(
                &format!("columns separated by {name}"),
                "columns separated by commas, decimals with a point",
            );
        }
    }
    let header = String::from_utf8_lossy(first);
    if count(b',') > 0 && header.split(',').all(|cell| cell.trim().parse::<f64>().is_ok()) {
        return refused("numbers and no header", "a header row of column names `t,q1,..,tau1,..`");
    }
    Ok(bytes)
}

/// All cells as numbers, column by column.
fn cells(file: &str, header: &[String], reader: &mut ::csv::Reader<&[u8]>) -> Result<Vec<Vec<f64>>, BadInput> {
    let mut columns = vec![Vec::new(); header.len()];
    let mut row = ::csv::StringRecord::new();
    loop {
        match reader.read_record(&mut row) {
            Ok(true) => {}
            Ok(false) => return Ok(columns),
            Err(error) => {
                let line = error.position().map_or(0, |position| position.line());
                return Err(BadInput::new(file, format!("line {line}"), error, "a row of numbers"));
            }
        }
        let line = row.position().map_or(0, |position| position.line());
        if row.len() != header.len() {
            let expected = format!("{}, as in the header", header.len());
            return Err(BadInput::new(file, format!("line {line}"), format!("{} cells", row.len()), expected));
        }
        for ((cell, name), column) in row.iter().zip(header).zip(&mut columns) {
            match cell.parse::<f64>() {
                Ok(value) if value.is_finite() => column.push(value),
                _ => {
                    let place = format!("line {line}, column {name}");
                    return Err(BadInput::new(file, place, format!("`{cell}`"), "a finite number"));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(header: &str, rows: usize) -> String {
        let cells = header.split(',').count() - 1;
        let row = |k: usize| format!("{}{}\n", k as f64 * 0.001, format!(",{}.5", k).repeat(cells));
        format!("{header}\n{}", (0..rows).map(row).collect::<String>())
    }

    fn refusal(text: &str) -> String {
        parse("run.csv", text.as_bytes(), Torque::Required).unwrap_err().to_string()
    }

    #[test]
    fn columns_are_found_by_name_in_any_order() {
        let text = file("t,temp1,tau2,tau1,q1,q2,tau_cmd1", 12).replace("0.003,3.5,3.5", "0.003,30,-7");
        let columns = parse("run.csv", text.as_bytes(), Torque::Required).unwrap();
        assert_eq!((columns.q.shape(), columns.tau.shape()), ((12, 2), (12, 2)));
        assert!(columns.dq.is_none());
        assert_eq!(columns.tau[(3, 1)], -7.0);
        assert_eq!(columns.tau[(3, 0)], 3.5);
        assert_eq!(columns.extra.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>(), ["temp1", "tau_cmd1"]);
        assert_eq!(columns.extra[0].1[3], 30.0);
    }

    #[test]
    fn every_kind_of_bad_file_is_named_with_its_place() {
        let good = file("t,q1,q2,tau1,tau2", 12);
        let cases = [
            (good.replace("0.004,4.5,4.5,4.5", "0.004,4.5,4.5,NaN"), "run.csv: line 6, column tau1: got `NaN`"),
            (good.replace("0.004,4.5", "0.004,inf"), "line 6, column q1: got `inf`, expected a finite number"),
            (good.replace("0.004,4.5", "0.004,"), "line 6, column q1: got ``"),
            (good.replace("0.004,", "0.0015,"), "line 6, column t: got 0.0015, expected a time not before 0.003 s"),
            (good.replace("0.004,4.5", "0.004"), "line 6: got 4 cells, expected 5"),
            (file("t,q1,q3,tau1,tau2", 12), "no column `q2`"),
            (file("t,q1,q2,tau1", 12), "no column `tau2`"),
            (file("t,q1,q2,tau1,tau2,dq2", 12), "no column `dq1`"),
            (file("time,q1,tau1", 12), "no column `t`"),
            (file("t,q1,tau1,q1", 12), "line 1, column 4: got `q1`"),
            (file("t,q1,q9,tau1", 12), "at most 8 joints"),
            (file("t,q1,tau1", 9), "got 9 samples, expected at least 10 samples"),
            (String::new(), "no column `t`"),
        ];
        for (text, expected) in cases {
            let message = refusal(&text);
            assert!(message.contains(expected), "`{message}` does not say `{expected}`");
        }
        let still = (0..12).map(|_| "1.0,2.0,3.0\n").collect::<String>();
        assert!(refusal(&format!("t,q1,tau1\n{still}")).contains("time that advances"));
    }

    #[test]
    fn a_repeated_time_is_no_error() {
        let text = file("t,q1,tau1", 12).replace("0.004,", "0.003,");
        assert_eq!(parse("run.csv", text.as_bytes(), Torque::Required).unwrap().t[4], 0.003);
    }
}
