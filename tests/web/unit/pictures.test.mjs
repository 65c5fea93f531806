import assert from "node:assert/strict";
import { test } from "node:test";
import zlib from "node:zlib";
import { withNotes } from "../../../web/net/png.js";
import { MirrorBall, ballPixels } from "../../../web/panels/light.js";

const SIZE = 64;
const STILL = { azimuth: 0, elevation: 0, yaw: 0, pitch: 0, roll: 0 };

/** A PNG of one grey pixel. */
function png() {
  const chunk = (type, data) => {
    const body = Buffer.concat([Buffer.from(type), data]);
    const [length, check] = [Buffer.alloc(4), Buffer.alloc(4)];
    length.writeUInt32BE(data.length);
    check.writeUInt32BE(crc(body));
    return Buffer.concat([length, body, check]);
  };
  const header = Buffer.from([0, 0, 0, 1, 0, 0, 0, 1, 8, 0, 0, 0, 0]);
  const signature = Buffer.from([0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a]);
  return Buffer.concat([signature, chunk("IHDR", header), chunk("IDAT", zlib.deflateSync(Buffer.from([0, 128]))), chunk("IEND", Buffer.alloc(0))]);
}

/** CRC-32, as zlib writes it at the end of a gzip file: after that, the length. */
function crc(bytes) {
  return zlib.gzipSync(bytes).subarray(-8).readUInt32LE();
}

/** The chunks of a PNG: type, data, and whether the checksum is right. */
function chunksOf(bytes) {
  const chunks = [];
  for (let at = 8; at < bytes.length;) {
    const length = bytes.readUInt32BE(at);
    const body = bytes.subarray(at + 4, at + 8 + length);
    const right = crc(body) === bytes.readUInt32BE(at + 8 + length);
    chunks.push({ type: body.toString("latin1", 0, 4), text: body.toString("latin1", 4), right });
    at += length + 12;
  }
  return chunks;
}

test("notes are chunks with checksums, behind the header", async () => {
  const noted = await withNotes(new Blob([png()], { type: "image/png" }), { Title: "Grüße × 3", Software: "isogi" });
  const chunks = chunksOf(Buffer.from(await noted.arrayBuffer()));
  assert.deepEqual(chunks.map(({ type }) => type), ["IHDR", "tEXt", "tEXt", "IDAT", "IEND"]);
  assert.deepEqual(chunks.slice(1, 3).map(({ text }) => text), ["Title\0Grüße × 3", "Software\0isogi"]);
  assert.ok(chunks.every(({ right }) => right));
  assert.equal(noted.type, "image/png");
});

test("without notes a picture stays what it is", async () => {
  const noted = await withNotes(new Blob([png()]), {});
  assert.deepEqual(Buffer.from(await noted.arrayBuffer()), png());
});

test("a mirror ball reflects by twice the angle of its normal", () => {
  const edge = Math.SQRT1_2; // a normal 45° from the eye reflects to the side
  const pixels = ballPixels(SIZE);
  const at = (right, up) => {
    const [column, row] = [Math.round(((right + 1) * SIZE - 1) / 2), Math.round(((1 - up) * SIZE - 1) / 2)];
    return pixels.find(({ place }) => place === 4 * (row * SIZE + column)).ray;
  };
  const near = (ray, wanted) => ray.slice(0, 3).forEach((x, i) => assert.ok(Math.abs(x - wanted[i]) < 3 / SIZE, `[${ray}] is not [${wanted}]`));
  near(at(0, 0), [0, 0, 1]);
  near(at(edge, 0), [1, 0, 0]);
  near(at(0, -edge), [0, -1, 0]);
});

test("a mirror ball covers pi quarters of its square", () => {
  const cover = ballPixels(SIZE).reduce((sum, pixel) => sum + pixel.cover, 0);
  assert.ok(Math.abs(cover / SIZE ** 2 - Math.PI / 4) < 2e-3);
});

test("all rays of the ball are unit vectors", () => {
  for (const { ray: [x, y, z], cover } of ballPixels(SIZE)) if (cover === 1) assert.ok(Math.abs(Math.hypot(x, y, z) - 1) < 1e-12);
});

/** The ball's picture under a light whose pixels are a function of azimuth and elevation, in degrees. */
function painted(light, values) {
  const [width, height] = [360, 180];
  const data = new Uint8ClampedArray(4 * width * height);
  for (let row = 0; row < height; row++) {
    for (let column = 0; column < width; column++) data[4 * (row * width + column)] = light(column + 0.5, 89.5 - row);
  }
  let picture;
  const paint = {
    createImageData: (w, h) => ({ data: new Uint8ClampedArray(4 * w * h), width: w, height: h }),
    putImageData: (image) => { picture = image; },
  };
  new MirrorBall(paint, SIZE, { data, width, height }).draw(values);
  return (right, up) => picture.data[4 * (Math.floor(((1 - up) / 2) * SIZE) * SIZE + Math.floor(((right + 1) / 2) * SIZE))];
}

/** Red on the half of the sky around an azimuth. */
const around = (centre) => (azimuth) => (Math.cos(((azimuth - centre) * Math.PI) / 180) > 0 ? 200 : 0);

test("the middle of the ball mirrors what is behind the eye", () => {
  for (const azimuth of [0, 90, 200]) {
    assert.ok(painted(around(azimuth), { ...STILL, azimuth })(0, 0) > 190);
    assert.equal(painted(around(azimuth + 180), { ...STILL, azimuth })(0, 0), 0);
  }
});

test("the right of the ball mirrors what is to the right", () => {
  const ball = painted(around(90), STILL); // from +x, the right is +y
  assert.ok(ball(0.7, 0) > 100);
  assert.equal(ball(-0.7, 0), 0);
});

test("the top of the ball mirrors the sky's zenith", () => {
  const ball = painted((_, elevation) => (elevation > 45 ? 200 : 0), STILL);
  assert.ok(ball(0, 0.7) > 100);
  assert.equal(ball(0, -0.7), 0);
});

test("a light turned by its yaw is mirrored where it went", () => {
  const ball = painted(around(0), { ...STILL, yaw: 90 });
  assert.ok(ball(0.7, 0) > 100);
  assert.equal(ball(-0.7, 0), 0);
});
