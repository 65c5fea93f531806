/** Bytes of files that the page makes: notes in PNGs (PNG, third edition, 11.3.3), and ZIPs. */

import { writeRows } from "../view/npy.js";

const HEAD = 8 + 25; // bytes of the signature and of IHDR, which must remain the first chunk

/**
 * Return the same picture with notes in it.
 * @param {Blob} png
 * @param {Record<string, string>} notes by their keywords in PNG; in Latin-1
 * @returns {Promise<Blob>}
 */
export async function withNotes(png, notes) {
  const chunks = Object.entries(notes).map(([keyword, text]) =>
    chunk("tEXt", `${keyword}\0${text}`),
  );
  return new Blob([png.slice(0, HEAD), ...chunks, png.slice(HEAD)], { type: png.type });
}

/**
 * Make a chunk of a PNG: length, type, data and their checksum.
 * @param {string} type
 * @param {string} text
 */
function chunk(type, text) {
  const body = Uint8Array.from(`${type}${text}`, (character) => character.charCodeAt(0));
  const bytes = new Uint8Array(body.length + 8);
  bytes.set(body, 4);
  const numbers = new DataView(bytes.buffer);
  numbers.setUint32(0, text.length);
  numbers.setUint32(body.length + 4, crcOf(body));
  return bytes;
}

// Signatures of a ZIP's records (APPNOTE.TXT, 4.3).
const LOCAL = 0x04034b50;
const CENTRAL = 0x02014b50;
const END = 0x06054b50;
const VERSION = 20; // version 2.0 of the format
const UTF8 = 0x0800; // flag: names are UTF-8
const [LOCAL_BYTES, CENTRAL_BYTES, END_BYTES] = [30, 46, 22];

/** Remainders of all bytes by the polynomial of CRC-32. */
const TABLE = Uint32Array.from({ length: 256 }, (_, byte) => {
  let code = byte;
  for (let bit = 0; bit < 8; bit += 1) code = code & 1 ? (code >>> 1) ^ 0xedb88320 : code >>> 1;
  return code;
});

/**
 * Return the CRC-32 of bytes, as PNG (Annex D) and ZIP define it.
 * @param {Uint8Array} bytes
 * @returns {number}
 */
function crcOf(bytes) {
  let code = 0xffffffff;
  for (const byte of bytes) code = TABLE[(code ^ byte) & 255] ^ (code >>> 8);
  return (code ^ 0xffffffff) >>> 0;
}

/**
 * Pack files into a ZIP file, uncompressed, in their order.
 * @param {{path: string, file: Blob}[]} files of less than 4 GB in all
 * @returns {Promise<Blob>}
 */
export async function zipOf(files) {
  /** @type {BlobPart[]} */
  const parts = [];
  /** @type {Uint8Array<ArrayBuffer>[]} */
  const directory = [];
  let place = 0;
  for (const { path, file } of files) {
    const name = new TextEncoder().encode(path);
    // Read one file at a time for its checksum: the ZIP refers to the files without copying them.
    const crc = crcOf(new Uint8Array(await file.arrayBuffer()));
    const facts = [VERSION, UTF8, 0, 0, 0, crc, file.size, file.size, name.length, 0];
    const local = record(LOCAL, LOCAL_BYTES, facts, [2, 2, 2, 2, 2, 4, 4, 4, 2, 2]);
    const central = record(
      CENTRAL,
      CENTRAL_BYTES,
      [VERSION, ...facts, 0, 0, 0, 0, place],
      [2, 2, 2, 2, 2, 2, 4, 4, 4, 2, 2, 2, 2, 2, 4, 4],
    );
    parts.push(local, name, file);
    directory.push(central, name);
    place += LOCAL_BYTES + name.length + file.size;
  }

  // The directory repeats each file's record, with the place of the file.
  const size = directory.reduce((sum, { length }) => sum + length, 0);
  const count = files.length;
  const end = record(END, END_BYTES, [0, 0, count, count, size, place, 0], [2, 2, 2, 2, 4, 4, 2]);
  return new Blob([...parts, ...directory, end], { type: "application/zip" });
}

/**
 * Make a record: its signature, then numbers of 2 or 4 bytes each, little-endian.
 * @param {number} mark signature
 * @param {number} bytes length of the record
 * @param {number[]} numbers
 * @param {number[]} widths bytes of each number
 * @returns {Uint8Array<ArrayBuffer>}
 */
function record(mark, bytes, numbers, widths) {
  const data = new DataView(new ArrayBuffer(bytes));
  data.setUint32(0, mark, true);
  let at = 4;
  for (const [n, number] of numbers.entries()) {
    if (widths[n] === 2) data.setUint16(at, number, true);
    else data.setUint32(at, number, true);
    at += widths[n];
  }
  return new Uint8Array(data.buffer);
}

/**
 * Return the values that a grey picture shows as an `npy` file, from the picture's first channel.
 * @param {{data: Uint8ClampedArray, width: number, height: number}} picture RGBA
 * @param {readonly [number, number]} greys the values that are black and white in it
 * @returns {ArrayBuffer} read by `readRows`
 */
export function valuesOfGreys({ data, width, height }, [black, white]) {
  const values = Float32Array.from(
    { length: width * height },
    (_, i) => black + (data[4 * i] / 255) * (white - black),
  );
  return writeRows(values, width, height);
}
