//! Samples read back from an archive, one by one.

use std::io::{self, Read};

use super::sample_labels::SampleLabels;
use super::tar::TarReader;

/// A sample as it stands in an archive.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Sample {
    /// The number of the frame.
    pub(super) key: u64,
    /// What stands behind the number and a dot, and the bytes, in the order of the archive.
    pub(super) members: Vec<(String, Vec<u8>)>,
}

impl Sample {
    /// The bytes of a member.
    pub(super) fn member(&self, name: &str) -> Option<&[u8]> {
        self.members.iter().find(|(own, _)| own == name).map(|(_, bytes)| bytes.as_slice())
    }

    /// Its labels.
    pub(super) fn labels(&self) -> Result<SampleLabels, String> {
        let json = self.member("json").ok_or_else(|| format!("the frame {:09} has no labels", self.key))?;
        serde_json::from_slice(json).map_err(|error| format!("the labels of the frame {:09} cannot be read: {error}", self.key))
    }
}

/// The samples of an archive.
pub(super) fn samples_of<R: Read>(archive: R) -> impl Iterator<Item = io::Result<Sample>> {
    let mut reader = TarReader::new(archive);
    let mut ahead: Option<(u64, String, Vec<u8>)> = None;
    let mut is_over = false;
    let mut next_member = move || -> io::Result<Option<(u64, String, Vec<u8>)>> {
        let Some((name, bytes)) = reader.next()? else { return Ok(None) };
        let split = name.split_once('.').and_then(|(key, rest)| Some((key.parse::<u64>().ok()?, rest.to_owned())));
        let (key, rest) = split
            .ok_or_else(|| io::Error::new(io::ErrorKind::InvalidData, format!("{name} is no member of a sample: NUMBER.NAME is one")))?;
        Ok(Some((key, rest, bytes)))
    };
    std::iter::from_fn(move || {
        if is_over {
            return None;
        }
        let mut sample = ahead.take().map(|(key, name, bytes)| Sample { key, members: vec![(name, bytes)] });
        loop {
            match next_member() {
                Err(error) => {
                    is_over = true;
                    return Some(Err(error));
                }
                Ok(None) => {
                    is_over = true;
                    return sample.map(Ok);
                }
                Ok(Some((key, name, bytes))) => match &mut sample {
                    None => sample = Some(Sample { key, members: vec![(name, bytes)] }),
                    Some(own) if own.key == key => own.members.push((name, bytes)),
                    Some(_) => {
                        ahead = Some((key, name, bytes));
                        return sample.map(Ok);
                    }
                },
            }
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::tar::TarWriter;

    #[test]
    fn members_of_a_frame_come_together_and_a_cut_is_told() {
        let mut tar = TarWriter::new(Vec::new());
        for (name, bytes) in [("000000001.image.png", b"a"), ("000000001.json", b"b"), ("000000002.json", b"c")] {
            tar.add(name, bytes).unwrap();
        }
        let archive = tar.finish().unwrap();
        let samples: Vec<Sample> = samples_of(archive.as_slice()).map(Result::unwrap).collect();
        assert_eq!(samples.iter().map(|sample| (sample.key, sample.members.len())).collect::<Vec<_>>(), [(1, 2), (2, 1)]);
        assert_eq!(samples[0].member("json"), Some(&b"b"[..]));
        assert!(samples[1].labels().unwrap_err().contains("000000002 cannot be read"));
        let cut: Vec<io::Result<Sample>> = samples_of(&archive[..1300]).collect();
        assert!(cut.last().unwrap().is_err());
    }
}
