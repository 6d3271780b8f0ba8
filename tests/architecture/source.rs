//! Source text: what is code in it, and which paths it imports.

use std::collections::BTreeSet;

/// A source file: path relative to the repository with `/` between folders, and its text.
pub(super) struct Source {
    pub(super) path: String,
    pub(super) text: String,
}

impl Source {
    /// `["backend", "cpu", "accumulate"]` for `src/backend/cpu/accumulate.rs`; empty for the crate root.
    pub(super) fn module(&self) -> Vec<&str> {
        let inner = self.path.strip_prefix("src/").and_then(|p| p.strip_suffix(".rs")).unwrap_or_default();
        let parts = inner.split('/').filter(|p| !["", "mod", "lib", "main"].contains(p));
        parts.collect()
    }
}

/// The text with comments, strings and characters blanked, so that only code is left.
pub(super) fn code_of(text: &str) -> String {
    let mut code = String::new();
    let mut rest = text;
    while let Some(c) = rest.chars().next() {
        let skipped = literal_or_comment(rest);
        if skipped > 0 {
            code.push(' ');
            code.extend(rest[..skipped].chars().filter(|c| *c == '\n'));
            rest = &rest[skipped..];
        } else {
            code.push(c);
            rest = &rest[c.len_utf8()..];
        }
    }
    code
}

/// Length of the comment, string or character that `rest` begins with; 0 if it begins with code.
fn literal_or_comment(rest: &str) -> usize {
    let until =
        |end: &str, from: usize| rest[from..].find(end).map_or(rest.len(), |at| from + at + end.len());
    let hashes = rest.strip_prefix('r').map_or(0, |r| r.len() - r.trim_start_matches('#').len());
    if rest.starts_with("//") {
        rest.find('\n').unwrap_or(rest.len())
    } else if rest.starts_with("/*") {
        until("*/", 2)
    } else if rest.strip_prefix('r').is_some_and(|r| r[hashes..].starts_with('"')) {
        until(&format!("\"{}", "#".repeat(hashes)), hashes + 2)
    } else if rest.starts_with('"') {
        let mut escaped = false;
        let end = rest.char_indices().skip(1).find(|(_, c)| {
            let is_end = *c == '"' && !escaped;
            escaped = *c == '\\' && !escaped;
            is_end
        });
        end.map_or(rest.len(), |(at, _)| at + 1)
    } else if rest.starts_with("'\\") {
        until("'", 3)
    } else {
        // A character, unless it is a lifetime.
        let mut after = rest.strip_prefix('\'').map_or("".chars(), str::chars);
        let length = after.next().map_or(0, char::len_utf8);
        if length > 0 && after.next() == Some('\'') { length + 2 } else { 0 }
    }
}

/// Every path behind `crate::` or `super::` (which `root` says) from the crate root on, groups in braces taken apart.
pub(super) fn imports(source: &Source, root: &str) -> BTreeSet<Vec<String>> {
    let code = code_of(&source.text);
    let mut found = BTreeSet::new();
    for (at, _) in code.match_indices(root) {
        if code[..at].ends_with(|c: char| c == ':' || c == '_' || c.is_alphanumeric()) {
            continue;
        }
        let mut base: Vec<String> = source.module().iter().map(ToString::to_string).collect();
        let mut rest = code[at..].strip_prefix("crate::").inspect(|_| base.clear()).unwrap_or(&code[at..]);
        while let Some(next) = rest.strip_prefix("super::") {
            base.pop();
            rest = next;
        }
        collect(rest, &base, &mut found);
    }
    found
}

/// Adds the path, or all paths of the group, that `text` begins with, and hands back what follows.
fn collect<'a>(text: &'a str, base: &[String], found: &mut BTreeSet<Vec<String>>) -> &'a str {
    let (mut path, mut rest) = (base.to_vec(), text.trim_start());
    loop {
        if let Some(mut group) = rest.strip_prefix('{') {
            while !group.is_empty() && !group.starts_with('}') {
                group = collect(group, &path, found).trim_start();
                group = group.strip_prefix(',').unwrap_or(group).trim_start();
            }
            return group.strip_prefix('}').unwrap_or(group);
        }
        let name = |text: &str| text.find(|c: char| c != '_' && !c.is_alphanumeric()).unwrap_or(text.len());
        let end = if rest.starts_with('*') { 1 } else { name(rest) };
        path.push(rest[..end].to_owned());
        rest = rest[end..].trim_start();
        if let Some(next) = rest.strip_prefix("::") {
            rest = next.trim_start();
            continue;
        }
        found.insert(path);
        let alias = rest.strip_prefix("as ").map(str::trim_start);
        return alias.map_or(rest, |alias| &alias[name(alias)..]);
    }
}
