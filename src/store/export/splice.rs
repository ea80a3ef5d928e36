//! Identified bodies into a given URDF: only its `<inertial>` elements change.

use super::tree::Tree;
use super::urdf::{inertial, left_out};
use super::{Arm, Exported};
use plumbline_model::Body;
use roxmltree::{Document, Node};
use std::ops::Range;

/// `text`, whose tree is `tree`, with the arm's bodies: each whole in the link behind its joint, so that links fixed to that one lose
/// theirs. Everything else stays byte by byte.
pub fn write(arm: &Arm, text: &str, document: &Document, tree: &Tree) -> Exported {
    let mut notes = Vec::new();
    let mut edits: Vec<(Range<usize>, String)> = Vec::new();
    for (segment, link) in tree.segments.iter().zip(&arm.bodies.links) {
        let body = Body::of(link).seen_from(&segment.placement.inverse());
        let node = link_named(document, &segment.link);
        let (found, pad) = (child(node, "inertial"), indent(text, node) + "  ");
        let element = inertial(&body, &pad);
        match found {
            Some(old) => edits.push((old.range(), element.trim().to_string())),
            None => edits.push(insertion(text, node, &element)),
        }
        for (fixed, _) in &segment.fixed {
            if let Some(old) = child(link_named(document, fixed), "inertial") {
                edits.push((old.range(), String::new()));
                notes.push(format!("link `{fixed}` is fixed to `{}`, whose <inertial> now holds both", segment.link));
            }
        }
    }
    if !tree.beyond.is_empty() {
        notes.push(format!(
            "links behind the movable joints {} stay as they were; what was identified holds them, too, if they were mounted",
            tree.beyond.join(", ")
        ));
    }
    notes.extend(left_out(arm));
    edits.sort_by_key(|(range, _)| range.start);
    let mut out = String::with_capacity(text.len());
    let mut at = 0;
    for (range, replacement) in edits {
        out += &text[at..range.start];
        out += &replacement;
        at = range.end;
    }
    out += &text[at..];
    // The comment goes behind the root's start tag, in front of all edits: before it an XML declaration may have to be first.
    let start = document.root_element().range().start;
    let open = start + tag_end(&out[start..]).unwrap_or(0);
    let lines = [format!("Inertials by plumbline. {}", arm.origin())].into_iter().chain(notes.clone());
    out.insert_str(open, &format!("\n{}", super::comment(lines).trim_end()));
    Exported { text: out, notes }
}

fn link_named<'a, 'd>(document: &'a Document<'d>, name: &str) -> Node<'a, 'd> {
    let links = document.root_element().children().filter(|node| node.has_tag_name("link"));
    links.into_iter().find(|node| node.attribute("name") == Some(name)).expect("the tree names links of this document")
}

fn child<'a, 'd>(node: Node<'a, 'd>, tag: &str) -> Option<Node<'a, 'd>> {
    node.children().find(|node| node.has_tag_name(tag))
}

/// White space in front of an element on its line.
fn indent(text: &str, node: Node) -> String {
    let line = text[..node.range().start].rsplit('\n').next().unwrap_or("");
    line.chars().take_while(|c| c.is_whitespace()).collect()
}

/// Where and how a first child is put into an element, which may be empty: `<link name="x"/>`.
fn insertion(text: &str, node: Node, element: &str) -> (Range<usize>, String) {
    let range = node.range();
    let whole = &text[range.clone()];
    let end = tag_end(whole).unwrap_or(whole.len());
    let element = element.trim_end();
    if whole[..end].ends_with("/>") {
        let (at, pad) = (range.start + end - 2, indent(text, node));
        return (at..at + 2, format!(">\n{element}\n{pad}</link>"));
    }
    (range.start + end..range.start + end, format!("\n{element}"))
}

/// Behind the `>` that ends a start tag; one inside a quoted attribute does not.
fn tag_end(text: &str) -> Option<usize> {
    let mut quote = None;
    for (at, c) in text.char_indices() {
        match (quote, c) {
            (None, '>') => return Some(at + 1),
            (None, '"' | '\'') => quote = Some(c),
            (Some(open), close) if open == close => quote = None,
            _ => {}
        }
    }
    None
}
