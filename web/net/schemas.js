/** What the server answers: its documents as types, and the headers of a frame. */

/** @typedef {import("../view/rotation.js").Vec3} Vec3 */
/** @typedef {{min: number, max: number}} Range both ends included */
/** @typedef {{id: string, name: string, volume: string|null}} SceneLink `volume` is the address of an uploaded one */
/** @typedef {{limit_bytes: number, free_bytes: number}} UploadLimits */
/** @typedef {{scenes: SceneLink[], uploads: UploadLimits|null}} SceneList `uploads` is null where nothing may be uploaded */
/** @typedef {{id: string, name: string, href: string|null}} Environment light by its id; `href` is the address of an uploaded one */
/** @typedef {Record<string, string|number>} FrameQuery parameters of a frame request */
/** @typedef {{what: string, why: string, saves: {amount: number, unit: string, measured: boolean}[]}} Omission */
/** @typedef {{name: string, isovalue: number, suggested: boolean}} Preset `suggested` where it was found in the volume */
/** @typedef {{azimuth: number, elevation: number, angle: number}} Lobe a bright part of the light, degrees */

/**
 * @typedef {Omit<Partial<Record<import("../view/model.js").NumberKnob, number>>, "albedo"> & KnownDefaults} Defaults what
 * each parameter is where it is left out
 *
 * @typedef {object} KnownDefaults
 * @property {number} isovalue
 * @property {number} azimuth
 * @property {number} elevation
 * @property {number} distance
 * @property {number} fov
 * @property {number} yaw
 * @property {number} pitch
 * @property {number} roll
 * @property {number} exposure
 * @property {number|string} [albedo] a text where it has a colour
 * @property {string} [shine] where the surface shines
 * @property {string} [shading]
 * @property {string} [projection] of the camera
 */

/**
 * @typedef {object} Layer one kind of light that each texel keeps
 * @property {string} kind
 * @property {number} order of the harmonics
 * @property {number} channels
 * @property {string} precision
 * @property {number|null} coarse first band that is kept in bytes
 * @property {number[]} nodes albedos that others are interpolated from
 */

/**
 * @typedef {object} Plan what the scene needs, and what was left out
 * @property {string} representation
 * @property {Layer[]} layers
 * @property {Lobe[]} lobes
 * @property {number} bytes_per_texel
 * @property {number} full_bytes_per_texel
 * @property {{shown: number, total: number}} texels
 * @property {number} bounces
 * @property {number} samples
 * @property {Record<string, number>} errors relative, by cause
 * @property {string[]} notes
 * @property {Omission[]} left_out
 */

/**
 * @typedef {object} Volume
 * @property {string} name
 * @property {Vec3} size voxels
 * @property {Vec3} spacing
 * @property {number[][]} affine from voxel indices to the world: three rows of four
 * @property {string} dtype
 * @property {[number, number]} value_range
 * @property {number} holes voxels that are not finite
 * @property {string} unit of lengths; "" where unknown
 * @property {string} letters where the world's axes point in a patient, such as "RAS"; "" elsewhere
 * @property {string} axes where the voxels' axes point in a patient
 * @property {[Vec3, Vec3]} bounds the least and the greatest world coordinates
 * @property {string[]} notes what was done to the file's field
 * @property {string} [read_as] what the file was taken for
 * @property {number} [time] its step in a series of `times`
 * @property {number} [times]
 */

/**
 * @typedef {object} Label a part of a segmentation
 * @property {number} value
 * @property {string} name
 * @property {string} colour `#rrggbb`
 * @property {boolean} shown
 */

/**
 * @typedef {object} Surface an isosurface that stays
 * @property {number} isovalue
 * @property {string} name empty where it has none
 * @property {Vec3} albedo linear RGB
 * @property {number} clear share of rays that passes it
 * @property {Vec3} transmission share of other light that gets through, diffuse, linear RGB
 */

/**
 * @typedef {object} Material what the surface may be made of
 * @property {string} kind
 * @property {Record<string, number|Vec3>} numbers of it, where views give none
 * @property {string|null} refused why the scene cannot be of it
 */

/**
 * @typedef {object} ColourScale what colours of the surface stand for
 * @property {string} name of the data
 * @property {string} map the name of the colours
 * @property {number} low the value of the first colour
 * @property {number} high the value of the last one
 * @property {string[]} colours `#rrggbb`, at equal steps
 * @property {string} outside `#rrggbb`, where there is no value
 * @property {Label[]} labels of a segmentation; none of other data
 */

/**
 * @typedef {object} Scene everything about one scene
 * @property {string} id
 * @property {string} name
 * @property {Volume} volume
 * @property {{counts: number[], edges: number[]}} histogram
 * @property {Defaults} defaults
 * @property {{azimuth: number, elevation: number, distance: number, target: Vec3}} start the camera at first
 * @property {Record<string, Range>} ranges
 * @property {Preset[]} presets
 * @property {number[]} stops isovalues, ascending: from one to the next the surface moves about equally far
 * @property {string} stops_note where they are even instead; "" where that is nowhere
 * @property {string[]} shadings
 * @property {{type: string, name: string}[]} lights
 * @property {Environment[]} environments light that the scene may be shown in, besides its own
 * @property {Vec3} albedo
 * @property {Range|null} albedos that views may ask for; null where they may not
 * @property {ColourScale|null} colours of a surface whose albedo comes from data; null where it has one albedo
 * @property {Surface[]} surfaces pinned beside the one that slides
 * @property {number} clear share of rays that passes the one that slides
 * @property {Vec3} transmission share of other light that gets through it, diffuse, linear RGB
 * @property {string} material its own, as views spell it
 * @property {Material[]} materials all of them
 * @property {string[]} shines kinds of shine that views may ask for; none where the surface is diffuse
 * @property {boolean} cuts whether planes across the world's axes may cut it: its voxels lie along them
 * @property {string} solid "above" or "below" the isovalue
 * @property {number} target_error relative
 * @property {boolean} rotating whether the light may be turned
 * @property {boolean} turns whether turning it shows
 * @property {{low: number, high: number, colours: string[]}} error_scale
 * @property {Plan} plan
 */

/**
 * @typedef {object} Job work of the server that goes on when its request has been answered
 * @property {"accepted"|"running"|"successful"|"failed"|"dismissed"} status
 * @property {string} message
 * @property {number} progress in percent
 * @property {{low: number, likely: number, high: number}|null} time_left seconds
 * @property {{rel: string, href: string, title: string}[]} links
 */

/** @typedef {"final"|"converging"|"provisional"} State of a pixel of the surface */

/**
 * @typedef {object} SurfacePoint what one pixel of a view shows
 * @property {string} unit of lengths; "" where unknown
 * @property {Vec3} position world
 * @property {string} sides of a patient on which the coordinates lie; "" elsewhere
 * @property {Vec3} voxel indices, x first
 * @property {number|null} value the isovalue; null on a wall
 * @property {number|null} wall its number; null on the isosurface
 * @property {Vec3} normal world, outward, of length 1
 * @property {Vec3} light linear RGB
 * @property {string} displayed the same in sRGB, `#rrggbb`
 * @property {State} state
 * @property {number} error relative
 */

/**
 * @typedef {object} Size of a surface, in squares and cubes of the unit
 * @property {string} unit of lengths; "" where unknown
 * @property {number} area 0 where there is no surface
 * @property {number} area_error
 * @property {number} volume that it encloses
 * @property {number} volume_error
 * @property {boolean} is_open whether the solid reaches a side of the volume
 */

/** @typedef {Record<State, number>} Coverage shares of the surface pixels */

/**
 * @typedef {object} Facts what a frame says about itself
 * @property {boolean} provisional
 * @property {Coverage} coverage
 * @property {number} error total relative RMSE; NaN where the server gives none
 * @property {number} controls pixels that measured it; of none it is a prediction
 * @property {number|null} p99 error that 99 % of the pixels stay below; null where it is not measured
 * @property {[number, number]|null} p99_interval its 95 % interval
 * @property {{needed: number, final: number}} chunks
 * @property {{low: number, likely: number, high: number}|null} timeLeft seconds until all is final; null if unknown
 * @property {Record<string, number>} timing milliseconds of each stage of its making
 */

/**
 * @typedef {object} Frame
 * @property {Blob|null} blob the encoded picture; null where it has not changed
 * @property {string|null} etag
 * @property {Facts|null} facts
 */

/** @typedef {{at: string, version: string, final: boolean}} ListedChunk texels that a view reads, and how far they are baked */

/**
 * @typedef {object} CardFacts whether a graphics card can draw a view, and what it takes
 * @property {boolean} drawable
 * @property {string} reason in sentences, where it cannot
 * @property {(import("../card/document.js").CardDocument & {grounds: Record<string, Vec3>})|null} scene null where it cannot
 */

/**
 * @typedef {object} StreamMessage the JSON that comes before a picture over a stream
 * @property {number} id of the view that it answers
 * @property {boolean} draft
 * @property {string} media_type
 * @property {Record<string, number>} timing
 * @property {Omit<Facts, "timeLeft"|"timing"> & {time_left: Facts["timeLeft"]}} facts
 * @property {ListedChunk[]} [chunks] that the picture reads, where they were asked for
 * @property {{status?: number, detail?: string}} [problem] in place of all others
 */

/**
 * The states of pixels, from the best: light becomes provisional, then converging, then final.
 * @type {State[]}
 */
export const STATES = ["final", "converging", "provisional"];

/**
 * The facts in the headers of a frame; null where there are none.
 * @param {Headers} headers
 * @returns {Facts|null}
 */
export function readFacts(headers) {
  if (!headers.has("Isogi-Provisional")) return null;
  return {
    provisional: headers.get("Isogi-Provisional") === "?1",
    coverage: { final: 0, converging: 0, provisional: 0, ...parsePairs(headers.get("Isogi-Coverage")) },
    ...readErrors(headers.get("Isogi-Error") ?? ""),
    chunks: { needed: 0, final: 0, ...parsePairs(headers.get("Isogi-Chunks")) },
    timeLeft: readTimeLeft(headers.get("Isogi-Time-Left")),
    timing: parseTiming(headers.get("Server-Timing")),
  };
}

/**
 * What a header such as `0.018; noise=0.006; low=0.015; high=0.021; controls=256; p99=0.06; …` says of errors.
 * @param {string} header
 * @returns {Pick<Facts, "error"|"controls"|"p99"|"p99_interval">}
 */
function readErrors(header) {
  const { controls = 0, p99 = null, "p99-low": low, "p99-high": high } = parsePairs(header.replaceAll(";", ","));
  return { error: Number.parseFloat(header), controls, p99, p99_interval: p99 === null ? null : [low, high] };
}

/**
 * A picture that came over a stream, with the facts of the message before it.
 * @param {Pick<StreamMessage, "media_type"|"timing"|"facts"|"chunks">} message
 * @param {Blob} data
 * @returns {{blob: Blob, facts: Facts, chunks?: ListedChunk[]}}
 */
export function streamedFrame({ media_type: type, timing, chunks, facts: { time_left: timeLeft, ...facts } }, data) {
  return { blob: new Blob([data], { type }), facts: { ...facts, timeLeft, timing }, ...(chunks && { chunks }) };
}

/**
 * Read a header of the form `final=0.81, converging=0.12` into numbers.
 * @param {string|null} text
 * @returns {Record<string, number>}
 */
export function parsePairs(text) {
  const pairs = (text ?? "").split(",").map((pair) => pair.trim().split("="));
  return Object.fromEntries(pairs.filter(([, number]) => number).map(([name, number]) => [name, Number(number)]));
}

/**
 * Read a `Server-Timing` header into milliseconds of each stage; their total is left out.
 * @param {string|null} text
 * @returns {Record<string, number>}
 */
export function parseTiming(text) {
  const stages = (text ?? "").split(",").map((stage) => stage.trim().split(";dur="));
  const named = stages.filter(([name, ms]) => ms && name !== "total");
  return Object.fromEntries(named.map(([name, ms]) => [name, Number(ms)]));
}

/** @param {string|null} text @returns {Facts["timeLeft"]} */
function readTimeLeft(text) {
  return text === null ? null : /** @type {Facts["timeLeft"]} */ (parsePairs(text));
}
