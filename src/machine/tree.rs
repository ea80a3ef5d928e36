//! `/proc` and `/sys`, or a copy of them for tests.

use std::fs;
use std::path::{Path, PathBuf};

/// The root under which `proc` and `sys` are found.
#[derive(Clone, Debug)]
pub struct Tree(PathBuf);

impl Default for Tree {
    fn default() -> Tree {
        Tree::at("/")
    }
}

impl Tree {
    pub fn at(root: impl Into<PathBuf>) -> Tree {
        Tree(root.into())
    }

    /// A file's text without the blanks around it; `None` where it is not there or can't be read.
    pub fn read(&self, path: impl AsRef<Path>) -> Option<String> {
        Some(fs::read_to_string(self.0.join(path)).ok()?.trim().to_string())
    }

    pub fn number(&self, path: impl AsRef<Path>) -> Option<i64> {
        self.read(path)?.parse().ok()
    }

    /// Names in a folder, in order.
    pub fn names(&self, folder: impl AsRef<Path>) -> Vec<String> {
        let Ok(entries) = fs::read_dir(self.0.join(folder)) else { return Vec::new() };
        let mut names: Vec<String> = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok()).collect();
        names.sort_by_key(|name| (name.len(), name.clone()));
        names
    }

    /// The folders of the processors, as in `sys/devices/system/cpu/cpu0`.
    pub fn cpus(&self) -> Vec<(usize, PathBuf)> {
        let folder = Path::new("sys/devices/system/cpu");
        let number = |name: &str| name.strip_prefix("cpu")?.parse::<usize>().ok();
        self.names(folder).iter().filter_map(|name| Some((number(name)?, folder.join(name)))).collect()
    }
}

/// Whether a list as the kernel writes them (`0-2,5`) has this number in it.
pub(super) fn list_has(list: &str, number: usize) -> bool {
    list.split(',').any(|part| {
        let mut ends = part.trim().splitn(2, '-').map(|end| end.trim().parse::<usize>().ok());
        let first = ends.next().flatten();
        let last = ends.next().map_or(first, |last| last);
        matches!((first, last), (Some(first), Some(last)) if (first..=last).contains(&number))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_are_read_as_the_kernel_writes_them() {
        for (list, inside, outside) in [
            ("0-2,5", vec![0, 1, 2, 5], vec![3, 4, 6]),
            ("3", vec![3], vec![0, 2]),
            ("", vec![], vec![0]),
            ("x-2", vec![], vec![1]),
        ] {
            assert!(inside.into_iter().all(|number| list_has(list, number)), "{list}");
            assert!(!outside.into_iter().any(|number| list_has(list, number)), "{list}");
        }
    }
}
