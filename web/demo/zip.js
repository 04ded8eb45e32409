/** A ZIP archive of files that are stored as they are. */

const table = Uint32Array.from({ length: 256 }, (_, n) => {
  let c = n;
  for (let k = 0; k < 8; k++) c = c & 1 ? 0xedb88320 ^ (c >>> 1) : c >>> 1;
  return c;
});

function crc32(bytes) {
  let c = 0xffffffff;
  for (const byte of bytes) c = table[(c ^ byte) & 255] ^ (c >>> 8);
  return ~c >>> 0;
}

/** A Blob with the files, each `{ name, bytes }`. */
export function zip(files) {
  const parts = [];
  const entries = [];
  let offset = 0;
  const numbers = (...pairs) => {
    const view = new DataView(new ArrayBuffer(pairs.reduce((sum, [size]) => sum + size, 0)));
    let at = 0;
    for (const [size, value] of pairs) {
      if (size === 2) view.setUint16(at, value, true);
      else view.setUint32(at, value, true);
      at += size;
    }
    return new Uint8Array(view.buffer);
  };
  // 1 January 1980, and names in UTF-8.
  const common = (bytes, name) => [[2, 20], [2, 0x800], [2, 0], [2, 0], [2, 0x21], [4, crc32(bytes)], [4, bytes.length], [4, bytes.length], [2, name.length], [2, 0]];
  for (const file of files) {
    const name = new TextEncoder().encode(file.name);
    const head = numbers([4, 0x04034b50], ...common(file.bytes, name));
    parts.push(head, name, file.bytes);
    entries.push(numbers([4, 0x02014b50], [2, 20], ...common(file.bytes, name), [2, 0], [2, 0], [2, 0], [4, 0], [4, offset]), name);
    offset += head.length + name.length + file.bytes.length;
  }
  const size = entries.reduce((sum, e) => sum + e.length, 0);
  const end = numbers([4, 0x06054b50], [2, 0], [2, 0], [2, files.length], [2, files.length], [4, size], [4, offset], [2, 0]);
  return new Blob([...parts, ...entries, end], { type: 'application/zip' });
}
