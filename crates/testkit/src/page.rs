//! Parts of pages in docs/ that a program writes or checks: the text between `<!-- NAME -->` and `<!-- end -->`.

const END: &str = "<!-- end -->";

/// The text of the page `name`, as in `docs/results/campaigns.md`.
pub fn read(name: &str) -> String {
    let file = crate::path(name);
    std::fs::read_to_string(&file).unwrap_or_else(|error| panic!("{}: {error}", file.display()))
}

/// Replaces one block of the page `name`.
///
/// # Panics
/// A page without such a block.
pub fn write_block(name: &str, block: &str, content: &str) {
    let text = fill(&read(name), block, content);
    std::fs::write(crate::path(name), text).unwrap_or_else(|error| panic!("{name}: {error}"));
}

pub fn fill(page: &str, block: &str, content: &str) -> String {
    let [before, _, after] = split(page, block).unwrap_or_else(|| panic!("no block `<!-- {block} -->` .. `{END}`"));
    format!("{before}{content}{after}")
}

pub fn block<'p>(page: &'p str, block: &str) -> Option<&'p str> {
    split(page, block).map(|[_, content, _]| content)
}

/// Text before a block, its content, and the text after it.
fn split<'p>(page: &'p str, block: &str) -> Option<[&'p str; 3]> {
    let open = format!("<!-- {block} -->\n");
    let start = page.find(&open)? + open.len();
    let end = start + page[start..].find(END)?;
    Some([&page[..start], &page[start..end], &page[end..]])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_block_is_replaced_and_the_others_stay() {
        let page = "a\n<!-- one -->\n1\n<!-- end -->\nb\n<!-- two -->\n2\n<!-- end -->\n";
        assert_eq!(block(page, "two"), Some("2\n"));
        assert_eq!(fill(page, "one", "3\n"), page.replace("1\n", "3\n"));
        assert_eq!(block(page, "three"), None);
    }
}
