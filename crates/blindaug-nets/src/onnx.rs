//! Checks of an ONNX file before a runtime reads it.
//!
//! An ONNX file is a message of protocol buffers. The runtime's parser trusts the lengths and numbers in a file; here every message
//! that the parser would look into is checked first.

/// The greatest depth to which messages may be nested; a graph within a graph takes three steps.
const MAX_DEPTH: usize = 64;
/// The most messages in a file; a network of a hundred thousand operators has about a million.
const MAX_MESSAGES: usize = 1 << 21;
/// The most operators of a network, limited because the runtime follows a chain of operators by recursion.
const MAX_NODES: usize = 1 << 15;
/// The product that a tensor's axes other than 0 may always have, since a tensor without elements may have long axes.
const EMPTY_AXES: u64 = 1 << 16;

/// A result, or what is wrong with a file in a few words.
type Checked<T> = Result<T, &'static str>;

/// The kinds of messages that the runtime looks into.
#[derive(Clone, Copy, PartialEq)]
enum Message {
    Model,
    Graph,
    Node,
    Attribute,
    Tensor,
    Value,
    Type,
    TensorType,
    Shape,
    Sequence,
    /// A message without messages in it.
    Leaf,
}

/// The contents of a field that gives its length.
enum Contents {
    /// Bytes that need no check.
    Bytes,
    /// Numbers of this many bytes each.
    Fixed(usize),
    /// Numbers of variable length, up to ten bytes.
    Varints,
    Message(Message),
}

impl Message {
    /// The contents of the field of this number, as onnx.proto defines them.
    fn contents(self, number: u64) -> Contents {
        use Message::*;
        Contents::Message(match (self, number) {
            (Tensor, 4) => return Contents::Fixed(4),
            (Tensor, 10) => return Contents::Fixed(8),
            (Tensor, 5 | 7) => return Contents::Varints,
            (Model, 7) | (Attribute, 6) => Graph,
            (Model, 8 | 14) | (Tensor, 13) | (Shape, 1) => Leaf,
            (Graph, 1) => Node,
            (Graph, 5) | (Attribute, 5) => Tensor,
            (Graph, 11..=13) => Value,
            (Node, 5) => Attribute,
            (Value, 2) | (Sequence, 1) => Type,
            (Type, 1) => TensorType,
            (Type, 4) => Sequence,
            (TensorType, 2) => Shape,
            _ => return Contents::Bytes,
        })
    }
}

/// Fails if the bytes are no well-formed message, the message is nested too deeply or has too many parts, or its weights are in
/// other files.
pub(crate) fn check(onnx: &[u8]) -> Checked<()> {
    Walk { messages: 0, nodes: 0 }.message(Message::Model, onnx, 0)
}

struct Walk {
    messages: usize,
    nodes: usize,
}

impl Walk {
    fn message(&mut self, kind: Message, mut bytes: &[u8], depth: usize) -> Checked<()> {
        self.messages += 1;
        self.nodes += usize::from(kind == Message::Node);
        if depth > MAX_DEPTH {
            return Err("its parts lie too deeply in one another");
        }
        if self.messages > MAX_MESSAGES || self.nodes > MAX_NODES {
            return Err("it has too many parts");
        }
        let length = bytes.len() as u64;
        let mut elements = 1u64;
        while !bytes.is_empty() {
            let tag = varint(&mut bytes)?;
            let number = tag >> 3;
            match tag & 7 {
                0 => {
                    let value = varint(&mut bytes)?;
                    match (kind, number) {
                        (Message::Tensor, 1) => elements = elements.saturating_mul(value.max(1)),
                        // Field 14 says where the tensor's values are: 1 is another file, of any name.
                        (Message::Tensor, 14) if value == 1 => {
                            return Err(
                                "its weights are in another file, which is not read: export all of it into one",
                            );
                        }
                        _ => {}
                    }
                }
                1 => drop(take(&mut bytes, 8)?),
                2 => {
                    let length = varint(&mut bytes)?;
                    let contents = take(&mut bytes, length)?;
                    self.field(kind.contents(number), contents, depth)?;
                }
                // These are the marks of groups, which the runtime reads as fields without a value.
                3 | 4 => {}
                5 => drop(take(&mut bytes, 4)?),
                _ => return Err("one of its fields is of no known kind"),
            }
        }
        // Each value takes at least a byte.
        if elements > length.max(EMPTY_AXES) {
            return Err("one of its tensors has more values than bytes");
        }
        Ok(())
    }

    fn field(&mut self, contents: Contents, mut bytes: &[u8], depth: usize) -> Checked<()> {
        match contents {
            Contents::Bytes => Ok(()),
            Contents::Fixed(size) if bytes.len().is_multiple_of(size) => Ok(()),
            Contents::Fixed(_) => Err("one of its lists of numbers is cut short"),
            Contents::Varints => {
                while !bytes.is_empty() {
                    varint(&mut bytes)?;
                }
                Ok(())
            }
            Contents::Message(kind) => self.message(kind, bytes, depth + 1),
        }
    }
}

fn take<'a>(bytes: &mut &'a [u8], length: u64) -> Checked<&'a [u8]> {
    let split = usize::try_from(length).ok().and_then(|n| bytes.split_at_checked(n));
    let (taken, rest) = split.ok_or("one of its parts is longer than what it is in")?;
    *bytes = rest;
    Ok(taken)
}

/// Reads a number of up to 64 bits, seven in each byte, the lowest first; every byte but the last has its highest bit set.
fn varint(bytes: &mut &[u8]) -> Checked<u64> {
    let mut value = 0;
    for i in 0..10 {
        let byte = take(bytes, 1)?[0];
        if i == 9 && byte > 1 {
            break;
        }
        value |= u64::from(byte & 0x7f) << (7 * i);
        if byte < 0x80 {
            return Ok(value);
        }
    }
    Err("one of its numbers has no end")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::runtime::Session;
    use std::path::Path;

    fn number(mut value: u64) -> Vec<u8> {
        let mut bytes = Vec::new();
        while value > 0x7f {
            bytes.push(value as u8 | 0x80);
            value >>= 7;
        }
        bytes.push(value as u8);
        bytes
    }

    /// A field of this number that gives its length.
    fn field(tag: u64, contents: &[u8]) -> Vec<u8> {
        [&number(tag << 3 | 2), &number(contents.len() as u64), contents].concat()
    }

    /// A file of one tensor of these axes and bytes.
    fn tensor(axes: &[u64], bytes: &[u8]) -> Vec<u8> {
        let mut tensor: Vec<u8> = axes.iter().flat_map(|&a| [number(1 << 3), number(a)].concat()).collect();
        tensor.extend([number(2 << 3), number(1), field(8, b"k"), field(9, bytes)].concat());
        [&[8, 8][..], &field(7, &field(5, &tensor))].concat()
    }

    /// The error of loading a file, which must be one line, or "nothing".
    fn said(file: Vec<u8>) -> String {
        let e = Session::new(Path::new("x.onnx"), file).err().map_or("nothing".into(), |e| e.to_string());
        assert!(!e.contains(char::is_control), "{e}");
        e
    }

    #[test]
    fn the_networks_of_the_tests_are_well_formed() {
        for entry in std::fs::read_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data")).unwrap() {
            let path = entry.unwrap().path();
            if path.extension().is_some_and(|e| e == "onnx") {
                assert_eq!(check(&std::fs::read(path).unwrap()), Ok(()));
            }
        }
        assert_eq!(check(&tensor(&[2, 1], &[0; 8])), Ok(()));
        assert_eq!(check(&tensor(&[0, 512], &[])), Ok(()));
    }

    #[test]
    fn numbers_without_an_end_and_lengths_that_leave_their_part() {
        // rten 0.27 would read the first file for ever, and take memory for the length in the second file.
        for (file, why) in [
            ([b"b".as_slice(), &[0xff; 31]].concat(), "no end"),
            ([number(2 << 3 | 2), number(1 << 60)].concat(), "longer than what it is in"),
            ([number(2 << 3 | 2), number(u64::MAX - 4), vec![0; 9]].concat(), "longer than what it is in"),
            (field(7, &[number(5 << 3 | 2), number(1), vec![]].concat()), "longer than what it is in"),
            (field(7, &field(5, &field(4, &[0; 5]))), "cut short"),
            (field(7, &field(5, &field(7, &[0xff; 11]))), "no end"),
            (vec![7 << 3 | 6, 0], "no known kind"),
        ] {
            let e = said([&[8, 8][..], &file].concat());
            assert!(e.contains("x.onnx: ") && e.contains(why), "{e}");
            assert!(said(file).contains("x.onnx: "));
        }
    }

    #[test]
    fn files_that_fuzzing_found_end_in_a_sentence() {
        for entry in
            std::fs::read_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/../../fuzz/regressions/onnx")).unwrap()
        {
            assert!(said(std::fs::read(entry.unwrap().path()).unwrap()).contains("x.onnx: "));
        }
    }

    #[test]
    fn tensors_have_no_more_values_than_bytes() {
        for axes in [&[1 << 40][..], &[1 << 32, 1 << 32], &[u64::MAX, 2], &[0, 1 << 40]] {
            assert_eq!(check(&tensor(axes, &[0; 8])), Err("one of its tensors has more values than bytes"));
        }
        assert!(said(tensor(&[3], &[0; 8])).contains("x.onnx: "));
    }

    #[test]
    fn weights_in_another_file_are_not_looked_for() {
        let place = field(13, &[field(1, b"location"), field(2, b"../../etc/passwd")].concat());
        let tensor = [number(1 << 3), number(4), place, number(14 << 3), number(1)].concat();
        assert!(said([&[8, 8][..], &field(7, &field(5, &tensor))].concat()).contains("in another file"));
    }

    #[test]
    fn graphs_within_graphs_and_many_parts() {
        let mut graph = Vec::new();
        for _ in 0..100 {
            graph = field(1, &field(5, &field(6, &graph)));
        }
        assert_eq!(check(&field(7, &graph)), Err("its parts lie too deeply in one another"));
        let mut kind = Vec::new();
        for _ in 0..100 {
            kind = field(4, &field(1, &kind));
        }
        assert_eq!(
            check(&field(7, &field(11, &field(2, &kind)))),
            Err("its parts lie too deeply in one another")
        );
        let many = field(1, &field(5, &[]).repeat(MAX_MESSAGES));
        assert_eq!(check(&field(7, &many)), Err("it has too many parts"));
    }

    #[test]
    fn a_long_chain_of_operators_is_loaded_or_refused() {
        let chain = |length: usize| {
            let nodes = (0..length).flat_map(|i| {
                let node = [field(1, format!("v{i}").as_bytes()), field(2, format!("v{}", i + 1).as_bytes())];
                field(1, &[node.concat(), field(4, b"Relu")].concat())
            });
            let value = |number, name: &str| field(number, &field(1, name.as_bytes()));
            let graph = [nodes.collect(), value(11, "v0"), value(12, &format!("v{length}"))].concat();
            [&[8, 8][..], &field(7, &graph), &field(8, &[2 << 3, 17])].concat()
        };
        assert_eq!(said(chain(3)), "nothing");
        assert_eq!(said(chain(MAX_NODES)), "nothing");
        assert!(said(chain(MAX_NODES + 1)).contains("too many parts"));
    }
}
