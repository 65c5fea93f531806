/** Notes in PNG files (PNG, third edition, 11.3.3), which say what the picture shows. */

const HEAD = 8 + 25; // the signature and the first chunk, which must stay the first

/**
 * The same picture with notes in it.
 * @param {Blob} png
 * @param {Record<string, string>} notes by PNG's keywords, in Latin-1
 * @returns {Promise<Blob>}
 */
export async function withNotes(png, notes) {
  const chunks = Object.entries(notes).map(([keyword, text]) =>
    chunk("tEXt", `${keyword}\0${text}`),
  );
  return new Blob([png.slice(0, HEAD), ...chunks, png.slice(HEAD)], { type: png.type });
}

/**
 * Length, type, data and their checksum.
 * @param {string} type
 * @param {string} text
 */
function chunk(type, text) {
  const body = Uint8Array.from(`${type}${text}`, (character) => character.charCodeAt(0));
  const bytes = new Uint8Array(body.length + 8);
  bytes.set(body, 4);
  const numbers = new DataView(bytes.buffer);
  numbers.setUint32(0, text.length);
  numbers.setUint32(body.length + 4, checksum(body));
  return bytes;
}

/** CRC-32, as PNG wants it (Annex D). @param {Uint8Array} bytes */
function checksum(bytes) {
  let crc = 0xffffffff;
  for (const byte of bytes) {
    crc ^= byte;
    for (let bit = 0; bit < 8; bit++) crc = (crc >>> 1) ^ (crc & 1 ? 0xedb88320 : 0);
  }
  return (crc ^ 0xffffffff) >>> 0;
}
