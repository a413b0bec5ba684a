//! The page of an effect: the documentation at the head of its source file, under the same headings for all effects.

/// The headings of a page, in their order. A page may have further ones below them.
pub const PAGE_HEADINGS: [&str; 7] = ["What it does", "Equation", "Parameters", "Signature", "Confused with", "Neglected", "Source"];

/// The module documentation at the head of a source file, without the code below it, which the program need not hold.
macro_rules! page_source {
    ($file:literal) => {{
        const WHOLE: &str = include_str!($file);
        const HEAD: [u8; $crate::effects::head_length(WHOLE)] = $crate::effects::head(WHOLE);
        const TEXT: &str = match std::str::from_utf8(&HEAD) {
            Ok(text) => text,
            Err(_) => panic!("whole lines of a text are a text"),
        };
        TEXT
    }};
}

/// Bytes of the first lines of a text that begin with `//!`.
pub(crate) const fn head_length(text: &str) -> usize {
    let bytes = text.as_bytes();
    let mut end = 0;
    while end + 3 <= bytes.len() && bytes[end] == b'/' && bytes[end + 1] == b'/' && bytes[end + 2] == b'!' {
        while end < bytes.len() && bytes[end] != b'\n' {
            end += 1;
        }
        if end < bytes.len() {
            end += 1;
        }
    }
    end
}

/// The first bytes of a text.
pub(crate) const fn head<const LENGTH: usize>(text: &str) -> [u8; LENGTH] {
    let mut head = [0; LENGTH];
    let mut i = 0;
    while i < LENGTH {
        head[i] = text.as_bytes()[i];
        i += 1;
    }
    head
}

/// The module documentation (`//!` lines) of a source file, as Markdown.
#[must_use]
pub fn page_of(source: &str) -> String {
    let lines = source.lines().map_while(|line| line.strip_prefix("//!"));
    lines.map(|line| line.strip_prefix(' ').unwrap_or(line).to_owned() + "\n").collect()
}

/// A page for a terminal: headings in capitals, the text below them set in, without the marks of Markdown.
///
/// ```
/// use boresight::effects::page_as_text;
///
/// assert_eq!(page_as_text("# Tilt\n\n## Source\n\nBrown (1966).\n"), "TILT\n\nSOURCE\n  Brown (1966).\n");
/// ```
#[must_use]
pub fn page_as_text(page: &str) -> String {
    let mut text = String::new();
    let mut is_below_heading = false;
    for line in page.lines().filter(|line| !line.starts_with("```")) {
        let below = std::mem::take(&mut is_below_heading);
        if let Some(heading) = line.strip_prefix("### ") {
            text += &format!("  {heading}:\n");
            is_below_heading = true;
        } else if let Some(heading) = line.strip_prefix("## ") {
            text += &format!("{}\n", heading.to_uppercase());
            is_below_heading = true;
        } else if let Some(title) = line.strip_prefix("# ") {
            text += &format!("{}\n", title.to_uppercase());
        } else if !line.is_empty() {
            text += &format!("  {}\n", line.replace("[`", "`").replace("`]", "`"));
        } else if !below {
            text.push('\n');
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::{head_length, page_of};

    #[test]
    fn a_source_keeps_its_head_alone() {
        let head = page_source!("page.rs");
        assert_eq!(page_of(head), page_of(include_str!("page.rs")));
        assert!(head.starts_with("//! The page of an effect") && !head.contains("fn "), "{head}");
    }

    #[test]
    fn a_head_ends_with_the_first_line_of_code() {
        assert_eq!(head_length("//! A.\n//!\n//! B.\nfn b() {}\n//! C.\n"), 18);
        assert_eq!(head_length("//! A."), 6);
        assert_eq!(head_length("//"), 0);
        assert_eq!(head_length(""), 0);
    }
}
