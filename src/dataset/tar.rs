//! Archives whose bytes follow from their members alone: ustar (POSIX.1-1988) with time, owner and group 0 and mode 0644.

use std::io::{self, Read, Write};

const BLOCK: usize = 512;

/// Writes an archive, member by member.
#[derive(Debug)]
pub(super) struct TarWriter<W: Write> {
    inner: W,
}

impl<W: Write> TarWriter<W> {
    pub(super) fn new(inner: W) -> Self {
        Self { inner }
    }

    /// Adds a member. Names are short: the number of a frame and a suffix.
    pub(super) fn add(&mut self, name: &str, bytes: &[u8]) -> io::Result<()> {
        self.inner.write_all(&header(name, bytes.len())?)?;
        self.inner.write_all(bytes)?;
        self.inner.write_all(&[0; BLOCK][..bytes.len().next_multiple_of(BLOCK) - bytes.len()])
    }

    /// Ends the archive.
    pub(super) fn finish(mut self) -> io::Result<W> {
        self.inner.write_all(&[0; 2 * BLOCK])?;
        self.inner.flush()?;
        Ok(self.inner)
    }
}

fn header(name: &str, length: usize) -> io::Result<[u8; BLOCK]> {
    const CHECKSUM: std::ops::Range<usize> = 148..156;
    let mut block = [0; BLOCK];
    let mut put = |at: usize, bytes: &[u8]| block[at..at + bytes.len()].copy_from_slice(bytes);
    if name.len() > 100 || length >= 1 << 33 {
        return Err(io::Error::new(
            io::ErrorKind::InvalidInput,
            format!("{name} with {length} bytes does not fit an archive of the kind ustar"),
        ));
    }
    put(0, name.as_bytes());
    put(100, b"0000644\0");
    put(108, b"0000000\0");
    put(116, b"0000000\0");
    put(124, format!("{length:011o}\0").as_bytes());
    put(136, b"00000000000\0");
    put(CHECKSUM.start, b"        ");
    put(156, b"0");
    put(257, b"ustar\x0000");
    let sum: u32 = block.iter().map(|byte| u32::from(*byte)).sum();
    block[CHECKSUM].copy_from_slice(format!("{sum:06o}\0 ").as_bytes());
    Ok(block)
}

/// Reads an archive of this kind, member by member.
#[derive(Debug)]
pub(super) struct TarReader<R: Read> {
    inner: R,
}

impl<R: Read> TarReader<R> {
    pub(super) fn new(inner: R) -> Self {
        Self { inner }
    }

    /// The next member: its name and its bytes; `None` at the end of the archive.
    pub(super) fn next(&mut self) -> io::Result<Option<(String, Vec<u8>)>> {
        let wrong = |what: &str| io::Error::new(io::ErrorKind::InvalidData, what.to_owned());
        let mut block = [0; BLOCK];
        self.inner.read_exact(&mut block)?;
        if block[0] == 0 {
            return Ok(None);
        }
        let name = block[..100].split(|byte| *byte == 0).next().unwrap_or_default();
        let name = String::from_utf8(name.to_vec()).map_err(|_| wrong("the name of a member is no UTF-8"))?;
        let length = std::str::from_utf8(&block[124..135]).ok().and_then(|text| usize::from_str_radix(text, 8).ok());
        let length = length.ok_or_else(|| wrong("the header of a member is damaged"))?;
        // Read as far as there is something, so that a damaged length asks for no memory.
        let mut bytes = Vec::new();
        let padded = length.next_multiple_of(BLOCK);
        if self.inner.by_ref().take(padded as u64).read_to_end(&mut bytes)? < padded {
            return Err(wrong("the archive ends within a member"));
        }
        bytes.truncate(length);
        Ok(Some((name, bytes)))
    }
}

/// Members of an archive: names and contents.
#[cfg(test)]
pub(super) fn members(archive: &[u8]) -> Vec<(String, Vec<u8>)> {
    let (mut found, mut rest) = (Vec::new(), archive);
    while rest.len() >= BLOCK && rest[0] != 0 {
        let name = String::from_utf8(rest[..100].split(|byte| *byte == 0).next().unwrap().to_vec()).unwrap();
        let length = usize::from_str_radix(std::str::from_utf8(&rest[124..135]).unwrap(), 8).unwrap();
        assert_eq!(&rest[..BLOCK], &header(&name, length).unwrap());
        found.push((name, rest[BLOCK..BLOCK + length].to_vec()));
        rest = &rest[BLOCK + length.next_multiple_of(BLOCK)..];
    }
    assert!(rest.len() == 2 * BLOCK && rest.iter().all(|byte| *byte == 0));
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn members_come_back_and_the_sum_is_that_of_the_standard() {
        let mut tar = TarWriter::new(Vec::new());
        tar.add("000000001.json", b"{}").unwrap();
        tar.add("000000001.mask.png", &[7; 512]).unwrap();
        let archive = tar.finish().unwrap();
        assert_eq!(members(&archive), [("000000001.json".to_owned(), b"{}".to_vec()), ("000000001.mask.png".to_owned(), vec![7; 512])]);
        let mut reader = TarReader::new(archive.as_slice());
        assert_eq!(reader.next().unwrap(), Some(("000000001.json".to_owned(), b"{}".to_vec())));
        assert_eq!(reader.next().unwrap(), Some(("000000001.mask.png".to_owned(), vec![7; 512])));
        assert_eq!(reader.next().unwrap(), None);
        assert!(TarReader::new(&archive[..700]).next().unwrap_err().to_string().contains("ends within a member"));
        assert_eq!(archive.len(), 512 + 512 + 512 + 512 + 1024);
        // GNU tar of a file "a" of 2 bytes, `--format=ustar --owner=0 --group=0 --numeric-owner --mode=0644 --mtime=@0`: its field is 005674.
        let block = header("a", 2).unwrap();
        let sum: u32 = block.iter().enumerate().map(|(at, byte)| if (148..156).contains(&at) { 32 } else { u32::from(*byte) }).sum();
        assert_eq!(&block[148..156], format!("{sum:06o}\0 ").as_bytes());
        assert!(header(&"x".repeat(101), 1).is_err());
    }
}
