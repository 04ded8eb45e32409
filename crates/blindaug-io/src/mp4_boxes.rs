//! Checks of the box structure of an MP4 file (ISO/IEC 14496-12) before the parser relies on it.
//!
//! `re_mp4` 0.4 trusts the sizes of boxes: a box of size zero inside another box makes it loop for ever, and a table in a box that
//! claims to be larger than the file makes it allocate that much memory. So every box that the parser enters is walked first: each box
//! must lie within its parent, and there may be no more samples than bytes in the file. Boxes that are not needed (titles, events,
//! other codecs) are hidden from the parser: it is given their names in capitals, which it does not know, so that it skips them.

use std::io::{BufRead, Read, Result, Seek, SeekFrom};

/// A parent box (`None` is the file itself), the number of bytes before its first child, and the names of the children that are read.
type Layout = (Option<&'static [u8; 4]>, u64, &'static [&'static [u8; 4]]);

const LAYOUTS: [Layout; 14] = [
    (None, 0, &[b"ftyp", b"moov", b"moof"]),
    (Some(b"moov"), 0, &[b"mvhd", b"trak", b"mvex"]),
    (Some(b"trak"), 0, &[b"tkhd", b"edts", b"mdia"]),
    (Some(b"edts"), 0, &[b"elst"]),
    (Some(b"mdia"), 0, &[b"mdhd", b"hdlr", b"minf"]),
    (Some(b"minf"), 0, &[b"vmhd", b"smhd", b"dinf", b"stbl"]),
    (Some(b"dinf"), 0, &[b"dref"]),
    (Some(b"dref"), 8, &[b"url "]),
    (Some(b"stbl"), 0, &[b"stsd", b"stts", b"ctts", b"stss", b"stsc", b"stsz", b"stco", b"co64"]),
    (Some(b"stsd"), 8, &[b"avc1"]),
    // A visual sample entry has 78 bytes of fields before its first child.
    (Some(b"avc1"), 78, &[b"avcC"]),
    (Some(b"mvex"), 0, &[b"mehd", b"trex"]),
    (Some(b"moof"), 0, &[b"mfhd", b"traf"]),
    (Some(b"traf"), 0, &[b"tfhd", b"tfdt", b"trun"]),
];

fn layout_of(holder: Option<&[u8; 4]>) -> Option<&'static Layout> {
    LAYOUTS.iter().find(|(name, ..)| *name == holder)
}

/// The most boxes of a file, enough for two days of fragments of a second each.
const MOST_BOXES: usize = 1 << 21;
/// The most samples of a file, enough for two days at 60 frames per second.
const MOST_SAMPLES: u64 = 1 << 24;

const OUTSIDE: &str = "one of its boxes reaches beyond the one that holds it";
const SHORT: &str = "one of its boxes is shorter than its own head";
const MANY_SAMPLES: &str = "it lists more pictures than it has room for";

/// A file of which the parser sees only boxes that have been checked.
pub(crate) struct Checked<R> {
    file: R,
    at: u64,
    /// The positions of the box names that are read in capitals, bytes from the file's start, ascending.
    capitals: Vec<u64>,
    samples: u64,
}

impl<R> Checked<R> {
    /// The number of samples that all tracks and fragments list.
    pub(crate) fn samples(&self) -> u64 {
        self.samples
    }
}

impl<R: BufRead + Seek> Checked<R> {
    /// Walks the boxes of a file of `length` bytes and goes back to its start.
    ///
    /// # Errors
    /// If a box is wrong; the error says in a few words how.
    pub(crate) fn new(mut file: R, length: u64) -> std::result::Result<Self, String> {
        let mut walk = Walk { file: &mut file, length, boxes: 0, samples: 0, capitals: Vec::new() };
        walk.inside(None, 0, length)?;
        let Walk { capitals, samples, .. } = walk;
        file.rewind().map_err(|e| e.to_string())?;
        Ok(Self { file, at: 0, capitals, samples })
    }
}

impl<R: Read> Read for Checked<R> {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize> {
        let n = self.file.read(bytes)?;
        let first = self.capitals.partition_point(|&name| name + 4 <= self.at);
        for &name in self.capitals[first..].iter().take_while(|&&name| name < self.at + n as u64) {
            for at in name.max(self.at)..(name + 4).min(self.at + n as u64) {
                bytes[(at - self.at) as usize].make_ascii_uppercase();
            }
        }
        self.at += n as u64;
        Ok(n)
    }
}

impl<R: Seek> Seek for Checked<R> {
    fn seek(&mut self, to: SeekFrom) -> Result<u64> {
        self.at = self.file.seek(to)?;
        Ok(self.at)
    }
}

struct Walk<'a, R> {
    file: &'a mut R,
    length: u64,
    boxes: usize,
    samples: u64,
    capitals: Vec<u64>,
}

impl<R: BufRead + Seek> Walk<'_, R> {
    fn bytes<const N: usize>(&mut self) -> std::result::Result<[u8; N], String> {
        let mut bytes = [0; N];
        self.file.read_exact(&mut bytes).map_err(|_| "it ends within one of its boxes".to_string())?;
        Ok(bytes)
    }

    fn number(&mut self) -> std::result::Result<u64, String> {
        self.bytes().map(|b| u32::from_be_bytes(b).into())
    }

    /// Checks the boxes inside `holder` (`None` is the file itself), from `at` to `end`, bytes from the file's start.
    fn inside(&mut self, holder: Option<[u8; 4]>, mut at: u64, end: u64) -> std::result::Result<(), String> {
        let &(_, skip, read) = layout_of(holder.as_ref()).unwrap_or(&LAYOUTS[0]);
        at += skip;
        let mut found_parameters = false;
        while at < end {
            // QuickTime ends the description of a format with zero bytes, after the box that is read.
            if holder == Some(*b"avc1") && (found_parameters || end - at < 8) {
                break;
            }
            self.boxes += 1;
            if self.boxes > MOST_BOXES {
                return Err("it has more boxes than any video".into());
            }
            let here = self.file.stream_position().map_err(|e| e.to_string())?;
            // A relative seek keeps what the reader has buffered.
            self.file.seek_relative(at as i64 - here as i64).map_err(|e| e.to_string())?;
            let size = self.number()?;
            let name: [u8; 4] = self.bytes()?;
            let (head, size) = match size {
                1 => (16, u64::from_be_bytes(self.bytes()?)),
                // The last box of a file may have size 0, which means that it ends with the file.
                0 if holder.is_none() => (8, end - at),
                size => (8, size),
            };
            if size < head {
                return Err(SHORT.into());
            }
            let is_read = read.contains(&&name);
            // A skipped box outside all other boxes, such as the coded frames, may be cut short.
            if size > end - at && (is_read || holder.is_some()) {
                return Err(OUTSIDE.into());
            }
            let next = at.saturating_add(size);
            if !is_read {
                self.capitals.push(at + 4);
            } else if layout_of(Some(&name)).is_some() {
                self.inside(Some(name), at + head, next)?;
            } else {
                self.samples_of(name)?;
            }
            found_parameters |= &name == b"avcC";
            at = next;
        }
        Ok(())
    }

    /// Counts the samples that a table lists; the file's position must be just after the head of the table's box.
    fn samples_of(&mut self, name: [u8; 4]) -> std::result::Result<(), String> {
        let count = match &name {
            b"stsz" => {
                self.number()?;
                let (size, count) = (self.number()?, self.number()?);
                if size * count > self.length {
                    return Err(MANY_SAMPLES.into());
                }
                count
            }
            b"trun" => {
                self.number()?;
                self.number()?
            }
            _ => return Ok(()),
        };
        self.samples += count;
        if self.samples > MOST_SAMPLES.min(self.length) {
            return Err(MANY_SAMPLES.into());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{BufReader, Cursor};

    fn boxed(name: &[u8; 4], contents: &[u8]) -> Vec<u8> {
        [&(8 + contents.len() as u32).to_be_bytes()[..], name, contents].concat()
    }

    /// Checks a file with these bytes in its `moov`: the bytes that the parser would read, or what is wrong.
    fn checked(moov: &[u8]) -> std::result::Result<Vec<u8>, String> {
        let file = [boxed(b"ftyp", b"isom\0\0\0\0"), boxed(b"moov", moov)].concat();
        let length = file.len() as u64;
        let mut checked = Checked::new(BufReader::with_capacity(16, Cursor::new(file)), length)?;
        let mut seen = Vec::new();
        checked.read_to_end(&mut seen).unwrap();
        Ok(seen)
    }

    /// Puts `inner` into nested boxes of these names, the outermost first.
    fn within(names: &[&[u8; 4]], inner: Vec<u8>) -> Vec<u8> {
        names.iter().rev().fold(inner, |inner, name| boxed(name, &inner))
    }

    const TABLES: &[&[u8; 4]] = &[b"trak", b"mdia", b"minf", b"stbl"];

    #[test]
    fn boxes_lie_within_what_holds_them_and_have_a_size() {
        let mut table = boxed(b"stts", &[0; 8]);
        assert!(checked(&within(TABLES, table.clone())).is_ok());
        for size in [0u32, 1, 7, 17, 1 << 30, u32::MAX] {
            table[..4].copy_from_slice(&size.to_be_bytes());
            let e = checked(&within(TABLES, table.clone())).unwrap_err();
            assert!([OUTSIDE, SHORT, "it ends within one of its boxes"].contains(&e.as_str()), "{size}: {e}");
            // The size of a box that is skipped is checked, too.
            let mut title = table.clone();
            title[4..8].copy_from_slice(b"udta");
            assert!(checked(&title).is_err(), "{size}");
        }
        // Four bytes are too few for a box.
        assert!(checked(&[0; 4]).is_err());
        let long = [&1u32.to_be_bytes()[..], b"udta", &24u64.to_be_bytes(), &[0; 8]].concat();
        assert!(checked(&long).is_ok());
    }

    #[test]
    fn there_are_no_more_samples_than_bytes() {
        let sizes = |size: u32, count: u32| {
            let numbers = [0, size, count].map(u32::to_be_bytes).concat();
            within(TABLES, boxed(b"stsz", &numbers))
        };
        assert!(checked(&sizes(1, 10)).is_ok());
        for (size, count) in [(1, 4_000_000_000), (0, 100_000_000), (100, 10), (u32::MAX, u32::MAX)] {
            assert_eq!(checked(&sizes(size, count)).unwrap_err(), MANY_SAMPLES);
        }
        let run = |count: u32| {
            boxed(b"moof", &boxed(b"traf", &boxed(b"trun", &[0, count].map(u32::to_be_bytes).concat())))
        };
        let whole = |run: Vec<u8>| {
            let file = [boxed(b"ftyp", b""), run].concat();
            Checked::new(Cursor::new(file.clone()), file.len() as u64).map(drop)
        };
        assert!(whole(run(3)).is_ok());
        assert_eq!(whole(run(4_000_000_000)).unwrap_err(), MANY_SAMPLES);
    }

    #[test]
    fn what_is_not_read_has_a_name_in_capitals() {
        let moov = [boxed(b"udta", b"meta"), within(TABLES, boxed(b"stts", b"free"))].concat();
        let seen = checked(&moov).unwrap();
        let text = String::from_utf8_lossy(&seen);
        // Only the names are in capitals, not the contents.
        assert!(text.contains("UDTAmeta") && text.contains("sttsfree") && text.contains("trak"), "{text}");
        let entry = within(
            &[b"trak", b"mdia", b"minf", b"stbl"],
            boxed(b"stsd", &[&[0; 8][..], &boxed(b"hvc1", &[0; 90])].concat()),
        );
        assert!(String::from_utf8_lossy(&checked(&entry).unwrap()).contains("HVC1"));
    }
}
