//! The page of an effect: the documentation at the head of its source file, under the same headings for all effects.

/// The headings of a page, in their order. A page may have further ones below them.
pub const PAGE_HEADINGS: [&str; 7] = ["What it does", "Equation", "Parameters", "Signature", "Confused with", "Neglected", "Source"];

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
