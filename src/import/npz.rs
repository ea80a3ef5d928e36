//! Arrays of NumPy: a zip archive of `.npy` files (NumPy's format, versions 1 to 3).

use super::table::{Named, understood};
use super::{Imported, Wanted};
use nalgebra::DMatrix;
use plumbline_core::BadInput;
use std::io::{Cursor, Read};

/// Largest array \[bytes\].
const MAX_BYTES: u64 = 2 << 30;
const MAGIC: &[u8] = b"\x93NUMPY";

/// Reads the arrays of an archive.
pub(super) fn read(file: &str, bytes: &[u8], wanted: &Wanted) -> Result<Imported, BadInput> {
    let broken =
        |error: zip::result::ZipError| BadInput::new(file, "file", error, "a zip archive as numpy.savez writes it");
    let mut archive = zip::ZipArchive::new(Cursor::new(bytes)).map_err(broken)?;
    let (mut named, mut all) = (Vec::new(), Vec::new());
    for index in 0..archive.len() {
        let mut entry = archive.by_index(index).map_err(broken)?;
        let name = entry.name().trim_end_matches(".npy").to_string();
        all.push(name.clone());
        let mut data = Vec::new();
        let read = entry.by_ref().take(MAX_BYTES).read_to_end(&mut data);
        let place = format!("array `{name}`");
        read.map_err(|error| BadInput::new(file, &place, error, "a readable array"))?;
        // Texts and objects are of no use here.
        if let Some(values) = array(&data).map_err(|(found, expected)| BadInput::new(file, &place, found, expected))? {
            named.push(Named { name, values });
        }
    }
    understood(file, named, &all, wanted)
}

/// The array of a `.npy` file with one or two dimensions; `None` for one of other elements than numbers. The error is what was found and what was expected.
pub(super) fn array(data: &[u8]) -> Result<Option<DMatrix<f64>>, (String, &'static str)> {
    let cut = || ("an end within the header".to_string(), "a whole .npy file");
    if !data.starts_with(MAGIC) {
        return Err(("another file".into(), "a .npy file"));
    }
    let version = *data.get(6).ok_or_else(cut)?;
    let (length, first): (usize, usize) = if version == 1 {
        let bytes: [u8; 2] = data.get(8..10).and_then(|bytes| bytes.try_into().ok()).ok_or_else(cut)?;
        (usize::from(u16::from_le_bytes(bytes)), 10)
    } else {
        let bytes: [u8; 4] = data.get(8..12).and_then(|bytes| bytes.try_into().ok()).ok_or_else(cut)?;
        (u32::from_le_bytes(bytes) as usize, 12)
    };
    let end = first.checked_add(length).ok_or_else(cut)?;
    let header = std::str::from_utf8(data.get(first..end).ok_or_else(cut)?).map_err(|_| cut())?;
    let value = |key: &str| header.split_once(&format!("'{key}':")).map(|(_, rest)| rest.trim_start());
    let quoted = value("descr").and_then(|rest| rest.strip_prefix('\''));
    let Some(descr) = quoted.and_then(|rest| rest.split_once('\'')).map(|(descr, _)| descr) else { return Ok(None) };
    let fortran = value("fortran_order").is_some_and(|rest| rest.starts_with("True"));
    let shape = value("shape").and_then(|rest| rest.strip_prefix('(')).and_then(|rest| rest.split_once(')'));
    let (shape, _) = shape.ok_or_else(cut)?;
    let sizes: Result<Vec<usize>, _> =
        shape.split(',').map(str::trim).filter(|size| !size.is_empty()).map(str::parse).collect();
    let sizes = sizes.map_err(|_| (format!("shape ({shape})"), "whole numbers"))?;
    let (rows, columns) = match sizes[..] {
        [rows] => (rows, 1),
        [rows, columns] => (rows, columns),
        _ => return Ok(None),
    };
    let body = &data[end..];
    let Some(values) = numbers(descr, body) else { return Ok(None) };
    if rows.checked_mul(columns) != Some(values.len()) {
        return Err((format!("{} values", values.len()), "as many as the shape says"));
    }
    Ok(Some(if fortran {
        DMatrix::from_vec(rows, columns, values)
    } else {
        DMatrix::from_row_slice(rows, columns, &values)
    }))
}

/// Numbers of the types that recordings have.
fn numbers(descr: &str, body: &[u8]) -> Option<Vec<f64>> {
    macro_rules! all {
        ($type:ty, $from:ident) => {{
            let (chunks, []) = body.as_chunks::<{ size_of::<$type>() }>() else { return None };
            Some(chunks.iter().map(|bytes| <$type>::$from(*bytes) as f64).collect())
        }};
    }
    match descr {
        "<f8" => all!(f64, from_le_bytes),
        "<f4" => all!(f32, from_le_bytes),
        ">f8" => all!(f64, from_be_bytes),
        "<i8" => all!(i64, from_le_bytes),
        "<u8" => all!(u64, from_le_bytes),
        "<i4" => all!(i32, from_le_bytes),
        _ => None,
    }
}
