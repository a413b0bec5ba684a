//! Tables of a dataset, column by column. What they are written as (Parquet) is somebody else's.

/// The values of a column.
#[derive(Clone, Debug, PartialEq)]
pub enum TableCells {
    /// Whole numbers.
    Whole(Vec<i64>),
    /// Numbers.
    Number(Vec<f64>),
    /// Words.
    Text(Vec<String>),
    /// True or false.
    Flag(Vec<bool>),
    /// Files that are images: their bytes, and their names.
    Image(Vec<(Vec<u8>, String)>),
}

impl TableCells {
    /// How many they are.
    #[must_use]
    pub fn len(&self) -> usize {
        match self {
            Self::Whole(cells) => cells.len(),
            Self::Number(cells) => cells.len(),
            Self::Text(cells) => cells.len(),
            Self::Flag(cells) => cells.len(),
            Self::Image(cells) => cells.len(),
        }
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn append(&mut self, more: Self) {
        match (self, more) {
            (Self::Whole(cells), Self::Whole(mut more)) => cells.append(&mut more),
            (Self::Number(cells), Self::Number(mut more)) => cells.append(&mut more),
            (Self::Text(cells), Self::Text(mut more)) => cells.append(&mut more),
            (Self::Flag(cells), Self::Flag(mut more)) => cells.append(&mut more),
            (Self::Image(cells), Self::Image(mut more)) => cells.append(&mut more),
            // A column keeps its kind: every row is made by the same function.
            (Self::Whole(_) | Self::Number(_) | Self::Text(_) | Self::Flag(_) | Self::Image(_), _) => {}
        }
    }
}

/// A column with its name.
#[derive(Clone, Debug, PartialEq)]
pub struct TableColumn {
    /// Its name, which ends in its unit.
    pub name: String,
    /// Its values.
    pub cells: TableCells,
}

impl TableColumn {
    pub(super) fn new(name: &str, cells: TableCells) -> Self {
        Self { name: name.to_owned(), cells }
    }
}

/// What writes tables.
pub trait TableWriter: Sync {
    /// Begins a file with columns like these; `None` if this build writes none.
    fn begin(&self, columns: &[TableColumn]) -> Option<Result<Box<dyn TableFile>, String>>;
}

/// A table on its way to the bytes of a file.
pub trait TableFile {
    /// Adds rows.
    fn add(&mut self, columns: &[TableColumn]) -> Result<(), String>;
    /// Ends the file, and gives its bytes.
    fn finish(self: Box<Self>) -> Result<Vec<u8>, String>;
}

/// Rows that are handed on at once: a group of rows in the file.
const ROWS_OF_A_GROUP: usize = 32_768;

/// Rows that come frame by frame, handed on in groups.
pub(super) struct TableRows<'w> {
    writer: &'w dyn TableWriter,
    file: Option<Box<dyn TableFile>>,
    waiting: Vec<TableColumn>,
}

impl<'w> TableRows<'w> {
    pub(super) fn new(writer: &'w dyn TableWriter) -> Self {
        Self { writer, file: None, waiting: Vec::new() }
    }

    /// Adds rows; the columns are the same every time.
    pub(super) fn add(&mut self, rows: Vec<TableColumn>) -> Result<(), String> {
        if self.waiting.is_empty() {
            self.waiting = rows;
        } else {
            for (column, more) in self.waiting.iter_mut().zip(rows) {
                column.cells.append(more.cells);
            }
        }
        if self.waiting.first().is_some_and(|column| column.cells.len() >= ROWS_OF_A_GROUP) { self.hand_on() } else { Ok(()) }
    }

    fn hand_on(&mut self) -> Result<(), String> {
        let columns = std::mem::take(&mut self.waiting);
        if self.file.is_none() {
            self.file = self.writer.begin(&columns).transpose()?;
        }
        if let Some(file) = &mut self.file
            && columns.first().is_some_and(|column| !column.cells.is_empty())
        {
            file.add(&columns)?;
        }
        Ok(())
    }

    /// The bytes of the file; `None` if this build writes none.
    pub(super) fn finish(mut self) -> Result<Option<Vec<u8>>, String> {
        if !self.waiting.is_empty() {
            self.hand_on()?;
        }
        self.file.map(TableFile::finish).transpose()
    }
}
