/**
 * Frames of the server, and the facts that they carry. The types of the server's documents are in
 * documents.d.ts.
 */

/** @typedef {import("../view/rotation.js").Vec3} Vec3 */
/** @typedef {import("../documents.js").Coverage} CoverageDocument */
/** @typedef {Record<string, string|number>} FrameQuery parameters of a frame request */

/**
 * @typedef {"isovalue"|"azimuth"|"elevation"|"distance"|"fov"|"yaw"|"pitch"|"roll"|"exposure"}
 *   SureKnob knobs of every scene
 *
 * @typedef {Omit<Partial<Record<import("../view/model.js").NumberKnob, number>>, "albedo">
 *   & Record<SureKnob, number>
 *   & {albedo?: number|string, shine?: string, shading?: string, projection?: string}} Defaults
 *   the value of each parameter if it is left out; an albedo with a colour is a string
 *
 * @typedef {Omit<import("../documents.js").Scene, "defaults">
 *   & {defaults: Defaults, start: import("../documents.js").Camera & {background?: unknown}}} Scene
 *   a scene's document with the camera and the background of its first view
 */

/** @typedef {"final"|"converging"|"provisional"} State of a pixel of the surface */

/**
 * @typedef {import("../documents.js").Point} Point
 * @typedef {{[Fact in keyof Point]: NonNullable<Point[Fact]>} & {state: State}} ShownPoint
 * @typedef {Omit<ShownPoint, "value"|"wall"> & Pick<Point, "value"|"wall">} SurfacePoint the point
 *   of the surface that a pixel shows
 */

/** @typedef {Record<State, number>} Coverage shares of the surface pixels */

/**
 * @typedef {Pick<CoverageDocument,
 *     "provisional"|"coverage"|"error"|"interval"|"controls"|"p99"|"p99_interval"|"chunks">
 *   & {surface: number, timeLeft: import("../view/format.js").Left|null,
 *     timing: Record<string, number>}} Facts
 *   facts of a frame: `error`, and `surface`, the number of pixels that show the surface, are NaN
 *   if the server gives none; `timing` has the milliseconds of each stage of rendering
 */

/**
 * @typedef {object} Frame
 * @property {Blob|null} blob the encoded picture; null if it has not changed
 * @property {string|null} etag
 * @property {Facts|null} facts
 */

/**
 * @typedef {object} StreamMessage the JSON that comes before a picture over a stream
 * @property {number} id of the view that it answers
 * @property {boolean} draft
 * @property {string} media_type
 * @property {Record<string, number>} timing
 * @property {Omit<Facts, "surface"|"timeLeft"|"timing">
 *   & Pick<CoverageDocument, "pixels"|"time_left"|"overdue">} facts
 * @property {import("../documents.js").CardChunk[]} [chunks] chunks that the picture reads, if they
 *   were asked for
 * @property {{status?: number, detail?: string}} [problem] replaces all other fields
 */

/**
 * The states of pixels, best first: light is provisional, then converging, then final.
 * @type {State[]}
 */
export const STATES = ["final", "converging", "provisional"];

/**
 * Read the facts of a frame from its headers; null if there are none.
 * @param {Headers} headers
 * @returns {Facts|null}
 */
export function readFacts(headers) {
  if (!headers.has("Isogi-Provisional")) return null;
  return {
    provisional: headers.get("Isogi-Provisional") === "?1",
    coverage: {
      final: 0,
      converging: 0,
      provisional: 0,
      ...parsePairs(headers.get("Isogi-Coverage")),
    },
    surface: Number.parseInt(headers.get("Isogi-Surface") ?? "", 10),
    ...readErrors(headers.get("Isogi-Error") ?? ""),
    chunks: { needed: 0, final: 0, ...parsePairs(headers.get("Isogi-Chunks")) },
    timeLeft: readTimeLeft(headers),
    timing: parseTiming(headers.get("Server-Timing")),
  };
}

/**
 * Read a header such as `0.018; low=0.015; high=0.021; controls=256; p99=0.06; …` into errors.
 * @param {string} header
 * @returns {Pick<Facts, "error"|"interval"|"controls"|"p99"|"p99_interval">}
 */
function readErrors(header) {
  const {
    low: least,
    high: most,
    controls = 0,
    p99 = null,
    "p99-low": low,
    "p99-high": high,
  } = parsePairs(header.replaceAll(";", ","));
  return {
    error: Number.parseFloat(header),
    interval: controls ? [least, most] : null,
    controls,
    p99,
    p99_interval: p99 === null ? null : [low, high],
  };
}

/**
 * Return a picture that came over a stream, with the facts of the message before it.
 * @param {Pick<StreamMessage, "media_type"|"timing"|"facts"|"chunks">} message message before the
 *   picture
 * @param {Blob} data
 * @returns {{blob: Blob, facts: Facts, chunks?: StreamMessage["chunks"]}}
 */
export function streamedFrame(
  { media_type: type, timing, chunks, facts: { time_left: left, overdue, pixels, ...facts } },
  data,
) {
  return {
    blob: new Blob([data], { type }),
    facts: { ...facts, surface: pixels.surface, timeLeft: left && { ...left, overdue }, timing },
    ...(chunks && { chunks }),
  };
}

/**
 * Read a header of the form `final=0.81, converging=0.12` into numbers.
 * @param {string|null} text
 * @returns {Record<string, number>}
 */
export function parsePairs(text) {
  const pairs = (text ?? "").split(",").map((pair) => pair.trim().split("="));
  return Object.fromEntries(
    pairs.filter(([, number]) => number).map(([name, number]) => [name, Number(number)]),
  );
}

/**
 * Read a `Server-Timing` header into the milliseconds of each stage, without their total.
 * @param {string|null} text
 * @returns {Record<string, number>}
 */
export function parseTiming(text) {
  const stages = (text ?? "").split(",").map((stage) => stage.trim().split(";dur="));
  const named = stages.filter(([name, ms]) => ms && name !== "total");
  return Object.fromEntries(named.map(([name, ms]) => [name, Number(ms)]));
}

/**
 * Read the estimated time until the picture is final, in seconds.
 * @param {Headers} headers
 * @returns {Facts["timeLeft"]}
 */
function readTimeLeft(headers) {
  const text = headers.get("Isogi-Time-Left");
  const { low, likely, high } = parsePairs(text);
  const overdue = headers.get("Isogi-Overdue") === "?1";
  return text === null ? null : { low, likely, high, overdue };
}
