/** The server's documents, from its OpenAPI: written by `make schemas`. */

/**
 * A camera on its orbit: angles in degrees, and the distance from the world's target in radii
 * of the volume.
 */
export interface Camera {
  azimuth: number;
  elevation: number;
  distance: number;
  target: [number, number, number];
}

/**
 * A chunk of texels by its place `z.y.x`, how far it is baked, and whether all that the view
 * reads is final.
 */
export interface CardChunk {
  at: string;
  version: string;
  final: boolean;
}

/**
 * The chunks that a view reads, most visible first, and how many of them are going to have more
 * light.
 */
export interface CardChunks {
  chunks: Array<CardChunk>;
  coming: number;
}

/**
 * Voxels along x, y, z, and the world: `world = rotation · box + origin`, `box = voxel index
 * · spacing`.
 *
 * Shadow rays start `offset` voxels along the normal, which is that of the B-spline's gradient
 * where `smooth`.
 */
export interface CardGrid {
  size: [number, number, number];
  spacing: [number, number, number];
  rotation: [[number, number, number], [number, number, number], [number, number, number]];
  origin: [number, number, number];
  offset: number;
  smooth: boolean;
}

/**
 * Linear RGB of the backgrounds that have names.
 */
export interface CardGrounds {
  dark: [number, number, number];
  light: [number, number, number];
}

/**
 * The key light of the request's view: radiance is `ambient + max(normal · key, 0) · sun`.
 */
export interface CardLambert {
  key: [number, number, number];
  sun: [number, number, number];
  ambient: [number, number, number];
}

/**
 * Texels along x, y, z, texels a voxel, and texels along each side of a chunk.
 */
export interface CardLattice {
  size: [number, number, number];
  density: [number, number, number];
  chunk: number;
}

/**
 * A layer of light that texels keep, and the order of its harmonics.
 */
export interface CardLayer {
  kind: string;
  order: number;
}

/**
 * The unturned light in a `unit` of radiance: the terms, the `sky` without shadows, the
 * least, the lobes.
 */
export interface CardLight {
  unit: number;
  terms: Array<CardTerm>;
  sky: [Array<number>, Array<number>, Array<number>];
  least: [number, number, number];
  lobes: Array<CardLobe>;
}

/**
 * Chunks of one request, and bytes of a volume, at most.
 */
export interface CardLimits {
  chunks: number;
  bytes: number;
}

/**
 * Addresses beside the document: of the list of chunks, and before the names of chunks.
 */
export interface CardLinks {
  chunks: string;
  light: string;
  transfer: string;
}

/**
 * An unturned lobe of the light: where it is, two radii of its disc, and what it gives from
 * straight above.
 */
export interface CardLobe {
  towards: [number, number, number];
  edges: [[number, number, number], [number, number, number]];
  shine: [number, number, number];
}

/**
 * What texels keep: `columns` numbers for each channel, from `straight` on of reflected
 * light alone.
 *
 * `ratios` is whether light is carried to pixels as irradiance ratios, `whole` whether texels
 * keep direct and reflected light as one, and `turns` whether the light may be turned.
 */
export interface CardPlan {
  representation: string;
  channels: number;
  columns: number;
  straight: number;
  ratios: boolean;
  whole: boolean;
  turns: boolean;
  layers: Array<CardLayer>;
}

/**
 * A scene as a graphics card draws it.
 */
export interface CardScene {
  grid: CardGrid;
  values: CardValues;
  volume: CardVolume;
  lattice: CardLattice;
  plan: CardPlan;
  light: CardLight;
  lambert: CardLambert;
  exposure: number;
  tone: CardTone;
  grounds: CardGrounds;
  isovalues: [number, number];
  target: number;
  expected: number;
  limits: CardLimits;
  links: CardLinks;
}

/**
 * Whether a page may draw a view by itself, `because` of what it may not and the `reason`,
 * else its scene.
 */
export interface Card {
  format: number;
  drawable: boolean;
  because: Array<string>;
  reason: string;
  scene: CardScene | null;
  version: string;
}

/**
 * Layers of voxels from the `first` to before the `last`, and the address of their
 * codes.
 */
export interface CardSlab {
  first: number;
  last: number;
  href: string;
}

/**
 * The unturned light that some columns meet: harmonics of an order, linear RGB times the
 * albedo, in the unit.
 *
 * Those of the square of its luminance say how noisy light is.
 */
export interface CardTerm {
  order: number;
  light: [Array<number>, Array<number>, Array<number>];
  square: Array<number>;
}

/**
 * Constants of the tone curve.
 */
export interface CardTone {
  gain: number;
  toe: number;
  shoulder: number;
}

/**
 * A value in the units of the volume's file is `offset + scale · voxel`.
 */
export interface CardValues {
  offset: number;
  scale: number;
  core: [number, number];
}

/**
 * Codes of voxels: `voxel = base + gain · code`, but for the code `hole` where a value is
 * missing.
 */
export interface CardVolume {
  type: "uint8" | "uint16" | "float32";
  gain: number;
  base: number;
  hole: number | null;
  bytes: number;
  slabs: Array<CardSlab>;
}

/**
 * Chunks that the view reads, and how many of them are final.
 */
export interface ChunkCounts {
  needed: number;
  final: number;
}

/**
 * The surface's colours by data: what of, the name of the map, and sRGB at equal steps from
 * `low` to `high`.
 *
 * `outside` is where there is no value. `labels` are those of a segmentation; the `colours`
 * are then those of the labels that are shown.
 */
export interface ColourScale {
  name: string;
  map: string;
  low: number;
  high: number;
  colours: Array<string>;
  outside: string;
  labels: Array<Label>;
}

/**
 * How far a view is: chunks, pixels by state, and the `error` of the frame: the total
 * relative RMSE.
 *
 * Control pixels, `controls` of them, measured it, with a 95 % `interval`; of none it is a
 * prediction, and the interval null. `noise` is the noise in it. 99 % of the pixels have an
 * error below `p99`, with a 95 % `p99_interval`; both are null where that is not measured.
 * `time_left` is null where it is unknown, or no worker is at the view; it is `overdue` once
 * the work takes longer than was said before.
 */
export interface Coverage {
  chunks: ChunkCounts;
  pixels: PixelCounts;
  coverage: Shares;
  error: number;
  noise: number;
  interval: [number, number] | null;
  controls: number;
  p99: number | null;
  p99_interval: [number, number] | null;
  provisional: boolean;
  time_left: TimeLeft | null;
  overdue: boolean;
}

/**
 * Light that a scene may be shown in: what views call it, its name, and its address where it
 * was uploaded.
 */
export interface Environment {
  id: string;
  name: string;
  href: string | null;
}

/**
 * The colours of `overlay=error`: sRGB at equal steps of the logarithm, from the error
 * `low` to `high`.
 */
export interface ErrorScale {
  low: number;
  high: number;
  colours: Array<string>;
}

/**
 * Voxels per bin, and the bins' edges in the volume's own units (one more than counts).
 *
 * Edges are even, or, where the axis is `logarithmic`, at even ratios but for the first.
 */
export interface Histogram {
  counts: Array<number>;
  edges: Array<number>;
  logarithmic: boolean;
}

/**
 * An address: what it is to the job (`rel`), and what is there.
 */
export interface JobLink {
  href: string;
  rel: string;
  type: string;
  title: string;
}

/**
 * One job. `progress` is in percent; times are in UTC, null while they are to come.
 *
 * `expires` is when a job that has ended is forgotten; all are when the server stops, and
 * prewarms are taken up when it starts again. `time_left` is null where it is unknown.
 */
export interface Job {
  jobID: string;
  processID: string;
  type: string;
  status: Status;
  message: string;
  progress: number;
  created: string;
  started: string | null;
  finished: string | null;
  updated: string;
  expires: string | null;
  time_left: TimeLeft | null;
  links: Array<JobLink>;
}

/**
 * A label of a segmentation: its value, its name, its colour as sRGB, and whether it is
 * shown.
 */
export interface Label {
  value: number;
  name: string;
  colour: string;
  shown: boolean;
}

/**
 * One kind of light that each texel keeps: order² numbers for each channel, in multiples of the
 * scale.
 *
 * Bands from `coarse` on are bytes, where it is not null. Where there are `nodes`, channels
 * are of grey surfaces with these albedos, and light of any other is mixed of theirs.
 */
export interface Layer {
  kind: string;
  order: number;
  channels: number;
  precision: string;
  coarse: number | null;
  scale: number;
  nodes: Array<number>;
  bytes_per_texel: number;
}

/**
 * One light of a scene.
 */
export interface Light {
  type: string;
  name: string;
}

/**
 * A small bright part of the unturned light: where it stands and its apparent diameter, in
 * degrees.
 *
 * `irradiance` is what a surface that faces it receives, linear RGB.
 */
export interface Lobe {
  azimuth: number;
  elevation: number;
  angle: number;
  irradiance: Array<number>;
}

/**
 * A material that views may ask for by its `kind`: its `numbers` where they give none, each
 * one or linear RGB.
 *
 * Where this scene cannot be of it `refused` says why; it is null elsewhere.
 */
export interface Material {
  kind: string;
  numbers: Record<string, number | [number, number, number]>;
  refused: string | null;
}

/**
 * Something that this scene does not need, why, and what that saves beside the same plan with
 * it.
 *
 * S1's harmonics, where a texel keeps none, are counted beside what S1 keeps for any scene.
 */
export interface Omission {
  what: string;
  why: string;
  saves: Array<Saving>;
}

/**
 * Pixels on the surface, by state.
 */
export interface PixelCounts {
  surface: number;
  final: number;
  converging: number;
  provisional: number;
}

/**
 * What is stored per texel for this scene, the errors that are expected of it, and what was
 * left out.
 *
 * `indirect_order` is that of reflected light, null where that has no harmonics; paths go on in
 * `branches` ways from their first hit; `samples` are a texel's most; `lobes` are lit by
 * shadow rays; `errors` are relative. `full_bytes_per_texel` is what S1 keeps. `projected`
 * are isovalues, from one to another, whose views project.
 */
export interface Plan {
  representation: string;
  order: number;
  indirect_order: number | null;
  channels: number;
  bounces: number;
  branches: number;
  bytes_per_texel: number;
  full_bytes_per_texel: number;
  precision: string;
  samples: number;
  lobes: Array<Lobe>;
  projected: Array<[number, number]>;
  layers: Array<Layer>;
  errors: Record<string, number>;
  notes: Array<string>;
  texels: Texel;
  left_out: Array<Omission>;
}

/**
 * What one pixel shows; all but `hit` and `unit` is null where it shows no surface.
 *
 * `position` and the outward unit `normal` are in the world, whose lengths have the `unit`,
 * empty where unknown; `sides` are the sides of a patient on which the coordinates lie, "LAS",
 * empty elsewhere. `voxel` are voxel indices, x first. `value` is the volume's there, null on
 * the `wall` with that number. `light` is linear RGB, `displayed` the same as a picture
 * shows it, sRGB; `state` is final, converging or provisional, and `error` the relative error
 * of this pixel.
 */
export interface Point {
  hit: boolean;
  unit: string;
  position: [number, number, number] | null;
  sides: string | null;
  voxel: [number, number, number] | null;
  value: number | null;
  wall: number | null;
  normal: [number, number, number] | null;
  light: [number, number, number] | null;
  displayed: string | null;
  state: string | null;
  error: number | null;
}

/**
 * An isovalue with a name; `suggested` where it was found in the volume, not given by the
 * scene.
 */
export interface Preset {
  name: string;
  isovalue: number;
  suggested: boolean;
}

/**
 * What a parameter may be, both ends included.
 */
export interface Range {
  min: number;
  max: number;
}

/**
 * What was saved: an amount of a unit, measured or else computed.
 */
export interface Saving {
  amount: number;
  unit: string;
  measured: boolean;
}

/**
 * One scene in the list of scenes; `volume` is the address of its volume where that was
 * uploaded.
 */
export interface SceneLink {
  id: string;
  name: string;
  href: string;
  volume: string | null;
}

/**
 * All scenes that this server shows, and what may be uploaded; null where nothing may.
 */
export interface SceneList {
  scenes: Array<SceneLink>;
  uploads: UploadLimits | null;
}

/**
 * What a client needs to show a scene: facts, histogram, defaults and ranges of every knob,
 * plan.
 *
 * `environment` is the id of the light that this is about, null for the scene's own;
 * `environments` are those that views may name.
 *
 * `read_only` is whether the store can only be read, so that nothing more is baked: a note of
 * the plan says so too.
 *
 * `presets` are isovalues worth a look: the scene's own, else boundaries between materials in
 * its volume. `stops` ascend through the range, and the surface moves about equally far from one
 * to the next; `stops_note` says where they are even instead, and is empty where that is
 * nowhere. `rotating` is whether the light may be turned, `turns` whether that shows: not
 * where the light is the same from all sides. `albedos` are those that a view may ask for, null
 * where it may not. `shines` are the kinds of shine that it may ask for, none where the surface
 * is diffuse. `cuts` is whether planes across the world's axes may cut it: its voxels lie along
 * them. `colours` are those of a surface whose albedo comes from data, null where it has one
 * `albedo`; that is then the most that colours reflect. `surfaces` are pinned beside the one
 * that slides, which lets the share `clear` of rays pass, and of other light its
 * `transmission` through, diffuse. `material` is what this is about, as views spell it, and
 * `materials` are all, with why some of them are refused. `view` is what the scene says of its
 * first view, by the names of parameters.
 */
export interface Scene {
  id: string;
  name: string;
  volume: Volume;
  histogram: Histogram;
  defaults: Record<string, number | string>;
  ranges: Record<string, Range>;
  presets: Array<Preset>;
  stops: Array<number>;
  stops_note: string;
  shadings: Array<string>;
  lights: Array<Light>;
  albedo: [number, number, number];
  albedos: Range | null;
  colours: ColourScale | null;
  surfaces: Array<Surface>;
  clear: number;
  transmission: [number, number, number];
  material: string;
  materials: Array<Material>;
  shines: Array<string>;
  bounces: number;
  cuts: boolean;
  solid: string;
  target_error: number;
  environment: string | null;
  environments: Array<Environment>;
  rotating: boolean;
  turns: boolean;
  view: Record<string, number | string | [number, number, number]>;
  error_scale: ErrorScale;
  plan: Plan;
  read_only: boolean;
}

/**
 * Shares of the surface pixels, by state.
 */
export interface Shares {
  final: number;
  converging: number;
  provisional: number;
}

/**
 * Area of a surface, and volume of the solid, in squares and cubes of the `unit`, which is
 * empty where unknown.
 *
 * `area` is 0 where there is no surface. `area_error` and `volume_error` are what the
 * voxels' size leaves open, in the same units. `is_open` is whether the solid reaches a side of
 * the volume, where it is taken to end.
 */
export interface Size {
  isovalue: number;
  unit: string;
  area: number;
  area_error: number;
  volume: number;
  volume_error: number;
  is_open: boolean;
}

/** How far a job is, in the words of OGC API Processes. */
export type Status = "accepted" | "running" | "successful" | "failed" | "dismissed";

/**
 * A pinned isosurface: its `name`, empty where it has none, the `albedo` of both its sides,
 * linear RGB, and the share of rays that passes straight through it, `clear`. Its
 * `transmission`, linear RGB, is what gets through diffuse.
 */
export interface Surface {
  isovalue: number;
  name: string;
  albedo: [number, number, number];
  transmission: [number, number, number];
  clear: number;
}

/**
 * Texels and chunks of the lattice, those that some view can show, and shown ones that can hold
 * no light.
 *
 * A chunk has `chunk` texels along each side.
 */
export interface Texel {
  total: number;
  shown: number;
  void: number;
  chunks: number;
  shown_chunks: number;
  chunk: number;
}

/**
 * Seconds until all pixels are final: most likely, and the range that they are likely in.
 */
export interface TimeLeft {
  low: number;
  likely: number;
  high: number;
}

/**
 * What an upload may be: `limit_bytes` itself, and `limit_files` in an archive; and
 * `free_bytes` of `quota_bytes` that all may take.
 */
export interface UploadLimits {
  limit_bytes: number;
  limit_files: number;
  quota_bytes: number;
  free_bytes: number;
}

/**
 * A volume: voxels and spacing along x, y, z; holes are voxels that are not finite.
 *
 * `affine` brings voxel indices to the world, (3, 4), whose lengths have the `unit`, empty
 * where unknown. `letters` say where the world's axes point in a patient, and `axes` where the
 * voxels' do; empty elsewhere. `bounds` are the least and the greatest world x, y, z. `notes`
 * tell what was done to the file's field, and `read_as` what the file was taken for, empty where
 * it is of no file. It is step `time` of a series of `times`, 0 of 1 where it is none.
 */
export interface Volume {
  name: string;
  size: [number, number, number];
  spacing: [number, number, number];
  dtype: string;
  value_range: [number, number];
  holes: number;
  affine: [[number, number, number, number], [number, number, number, number], [number, number, number, number]];
  unit: string;
  letters: string;
  axes: string;
  bounds: [[number, number, number], [number, number, number]];
  notes: Array<string>;
  read_as: string;
  time: number;
  times: number;
}
