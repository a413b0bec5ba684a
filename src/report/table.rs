//! Aligned text tables.

/// A table as text: the header, a rule, the rows, each line ended. Columns of numbers stand to the right, all others to the left.
/// A row may be shorter than the header; its missing cells are empty.
#[must_use]
pub fn table<R: AsRef<[C]>, C: AsRef<str>>(header: &[&str], rows: &[R]) -> String {
    let cell = |row: &R, column: usize| row.as_ref().get(column).map_or(String::new(), |cell| cell.as_ref().to_owned());
    let columns = rows.iter().map(|row| row.as_ref().len()).fold(header.len(), usize::max);
    let mut lines = vec![String::new(); rows.len() + 2];
    for column in 0..columns {
        let cells: Vec<String> = rows.iter().map(|row| cell(row, column)).collect();
        let title = header.get(column).copied().unwrap_or_default();
        let width = cells.iter().map(|cell| width(cell)).fold(width(title), usize::max);
        let right = cells.iter().any(|cell| !cell.is_empty()) && cells.iter().all(|cell| cell.is_empty() || is_number(cell));
        let gap = if column == 0 { "" } else { "  " };
        let parts = std::iter::once(title.to_owned()).chain(std::iter::once("─".repeat(width))).chain(cells);
        for (line, part) in lines.iter_mut().zip(parts) {
            let padding = " ".repeat(width - self::width(&part));
            *line += gap;
            *line += &if right { padding + &part } else { part + &padding };
        }
    }
    lines.iter().map(|line| line.trim_end().to_owned() + "\n").collect()
}

/// Columns that a text takes on a terminal: one for each character that is not a combining mark.
fn width(text: &str) -> usize {
    text.chars().filter(|c| !('\u{300}'..='\u{36f}').contains(c)).count()
}

/// Whether a cell holds a number, alone or with what follows one: `−3.2`, `5115 ± 3`, `12/40`, `+1.2 σ`, `< 0.1`, `–` for none.
fn is_number(cell: &str) -> bool {
    let unsigned = cell.trim_start_matches(['+', '-', '−', '±', '<', '>', '≤', '≥', '~', ' ']);
    unsigned.starts_with(|c: char| c.is_ascii_digit() || c == '.') || ["–", "-", "NaN", "inf", "∞"].contains(&cell.trim())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_stand_right_and_words_left() {
        let rows = [vec!["focal length", "2801.25", "px"], vec!["k1", "−3.2e-9", "px⁻²"], vec!["p1", "–"]];
        let text = table(&["parameter", "value", "unit"], &rows);
        let expected = "\
parameter       value  unit
────────────  ───────  ────
focal length  2801.25  px
k1            −3.2e-9  px⁻²
p1                  –
";
        assert_eq!(text, expected);
    }

    #[test]
    fn no_rows_leave_the_header() {
        let rows: [Vec<String>; 0] = [];
        assert_eq!(table(&["a", "bc"], &rows), "a  bc\n─  ──\n");
    }
}
