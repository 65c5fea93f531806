/** The server's documents, from its OpenAPI: written by `make schemas`. */

/**
 * A camera on its orbit: angles in degrees, the distance from the target in radii of the
 * volume, and the target in the world.
 */
export interface Camera {
  azimuth: number;
  elevation: number;
  distance: number;
  target: [number, number, number];
}

/**
 * A chunk of texels: its index `z.y.x`, the version of its light, and `final` if all
 * that the view reads of it is final.
 */
export interface CardChunk {
  at: string;
  version: string;
  final: boolean;
}

/**
 * The chunks that a view reads, most visible first, and the number of those that will get
 * more light.
 */
export interface CardChunks {
  chunks: Array<CardChunk>;
  coming: number;
}

/**
 * Colours by data at places `step` voxels apart, `size` along x, y, z: codes of values, or
 * two labels and the share of the second in units of 1/510.
 *
 * The `table` has the albedo of each code, linear RGB; code 0 stands for no value, and codes
 * beyond the table have its albedo. Light of texels is of the `brightest` albedo.
 */
export interface CardColours {
  kind: "values" | "labels";
  size: [number, number, number];
  step: [number, number, number];
  table: Array<[number, number, number]>;
  brightest: [number, number, number];
  bytes: number;
  slabs: Array<CardSlab>;
}

/**
 * Voxels along x, y, z, and their place in the world: `world = rotation · box + origin`,
 * `box = voxel index · spacing`.
 *
 * Shadow rays start `offset` voxels along the normal, which is the gradient of the B-spline if
 * `smooth`.
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
 * Linear RGB of the named backgrounds.
 */
export interface CardGrounds {
  dark: [number, number, number];
  light: [number, number, number];
}

/**
 * The lattice: texels along x, y, z, texels per voxel, and texels along each side of a
 * chunk.
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
 * The unturned light in a `unit` of radiance: terms, the `sky` without shadows, the
 * least light, and lobes.
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
 * Addresses relative to the document: of the list of chunks, and of light and transfer
 * before the names of chunks.
 */
export interface CardLinks {
  chunks: string;
  light: string;
  transfer: string;
}

/**
 * An unturned lobe of the light: its direction, two radii of its disc, and its radiance on
 * a surface that faces it.
 */
export interface CardLobe {
  towards: [number, number, number];
  edges: [[number, number, number], [number, number, number]];
  shine: [number, number, number];
}

/**
 * Constants of the local models: the direction to the key light, its light and that of all
 * other light on the albedo, and strength and exponent of Phong's highlight.
 *
 * The key is unturned, and `follows` the light's rotation, nothing, or the camera. In the last
 * case `key` has no meaning.
 */
export interface CardModel {
  key: [number, number, number];
  follows: "nothing" | "light" | "camera";
  sun: [number, number, number];
  ambient: [number, number, number];
  gloss: number;
  exponent: number;
}

/**
 * The light that texels keep: `columns` numbers for each channel, of reflected light only
 * from `straight` on.
 *
 * `ratios` is true if pixels interpolate irradiance ratios, `whole` if texels keep direct and
 * reflected light as one, `turns` if the light may be rotated: the document then has it in the
 * axes of the world, else in those of the volume's box.
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
  colours: CardColours | null;
  shine: CardShine | null;
  lattice: CardLattice;
  plan: CardPlan;
  light: CardLight;
  surfaces: Array<CardSurface> | null;
  model: CardModel;
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
 * If `drawable`, a page may draw the view itself, by its `scene`; else `because`
 * names the obstacles, and `reason` describes them.
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
 * The shine of a surface: `kind`, `roughness` and `strength` of its lobe, as the view
 * asks for them; others need no other document.
 *
 * Head on, metal mirrors its `albedo`, and plastic the share `plastic`.
 */
export interface CardShine {
  kind: string;
  roughness: number;
  strength: number;
  plastic: number;
  albedo: [number, number, number];
  surroundings: CardSurroundings;
}

/**
 * The light on one side of a surface without shadows, unturned: the `sky`, and the least
 * light.
 */
export interface CardSide {
  sky: [Array<number>, Array<number>, Array<number>];
  least: [number, number, number];
}

/**
 * Layers of voxels, from the `first` to the one before the `last`, and the address of
 * their codes.
 */
export interface CardSlab {
  first: number;
  last: number;
  href: string;
}

/**
 * One of several surfaces: its `isovalue` in the units of the file, null for the one that
 * slides; the share `clear` of rays that pass it; and its `albedo` over that of local models.
 *
 * Its outer side is towards lower values, its inner side towards higher ones.
 */
export interface CardSurface {
  isovalue: number | null;
  clear: number;
  albedo: [number, number, number];
  outer: CardSide;
  inner: CardSide;
}

/**
 * The light from far away as lat-long images in its own axes, `rows` × 2 rows at first and
 * half of that at each further level, and the address of all: halves of linear RGB, in units of
 * `brightness`.
 */
export interface CardSurroundings {
  rows: number;
  levels: number;
  brightness: number;
  bytes: number;
  href: string;
}

/**
 * The unturned light that some columns are multiplied by: harmonics of an order, linear RGB
 * times the albedo, in the unit.
 *
 * `square` are the harmonics of its squared luminance, from which noise is estimated.
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
 * Units of voxels: a value in the units of the volume's file is `offset + scale · voxel`.
 */
export interface CardValues {
  offset: number;
  scale: number;
  core: [number, number];
}

/**
 * Codes of voxels: `voxel = base + gain · code`; the code `hole` marks missing values.
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
 * The number of chunks that the view reads, and of those that are final.
 */
export interface ChunkCounts {
  needed: number;
  final: number;
}

/**
 * The colours of a surface by data: the name of the quantity, the name of the map, and sRGB at
 * equal steps from `low` to `high`.
 *
 * `outside` is the colour of places without a value. `labels` are those of a segmentation;
 * `colours` are then those of the visible labels.
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
 * The state of a view: chunks, pixels by state, and the `error` of the frame, its total
 * relative RMSE.
 *
 * The error is measured by `controls` control pixels, with a 95 % `interval`; without any it
 * is a prediction, and the interval is null. `noise` is the part of it that is noise. 99 % of
 * the pixels have an error below `p99`, with a 95 % `p99_interval`; both are null if that is
 * not measured. `time_left` is null if it is unknown, or if no worker is at the view;
 * `overdue` is true once the work takes longer than was predicted.
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
 * Light in which a scene may be shown: its id for views, its name, and its address if it
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
 * Voxels per bin, and the edges of the bins in the volume's units (one more than counts).
 *
 * Edges are evenly spaced, or, if `logarithmic`, have even ratios except for the first.
 */
export interface Histogram {
  counts: Array<number>;
  edges: Array<number>;
  logarithmic: boolean;
}

/**
 * A link: its relation to the job (`rel`), and the media type and title of its target.
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
 * `expires` is when a job that has ended is forgotten. All jobs are forgotten when the server
 * stops; prewarms are resumed when it starts again. `time_left` is null if it is unknown.
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
 * A label of a segmentation: its value, its name, its colour as sRGB, and `shown` if it
 * is visible.
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
 * Bands from `coarse` on are single bytes; null if there are none. If there are `nodes`,
 * channels belong to grey surfaces with these albedos, and light for other albedos is
 * interpolated.
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
 * A small bright part of the unturned light: its direction and apparent diameter, in degrees.
 *
 * `irradiance` is the irradiance of a surface that faces it, linear RGB.
 */
export interface Lobe {
  azimuth: number;
  elevation: number;
  angle: number;
  irradiance: Array<number>;
}

/**
 * A material that views may ask for by its `kind`, with its default `numbers`, each one
 * number or linear RGB.
 *
 * `refused` is the reason why this scene cannot have it, null if it can.
 */
export interface Material {
  kind: string;
  numbers: Record<string, number | [number, number, number]>;
  refused: string | null;
}

/**
 * Something that this scene does not need, the reason, and the saving compared with the same
 * plan including it.
 *
 * If texels keep no harmonics, the saving is compared with the coefficients that S1 keeps for any
 * scene.
 */
export interface Omission {
  what: string;
  why: string;
  saves: Array<Saving>;
}

/**
 * Numbers of surface pixels, by state.
 */
export interface PixelCounts {
  surface: number;
  final: number;
  converging: number;
  provisional: number;
}

/**
 * The light that is stored per texel for this scene, the expected errors, and the omissions.
 *
 * `indirect_order` is the order of reflected light, null if that has no harmonics; paths
 * continue in `branches` ways from their first hit; `samples` is the largest number for a
 * texel; `lobes` are lit by shadow rays; `errors` are relative. `full_bytes_per_texel` is
 * the amount that S1 keeps. `projected` are ranges of isovalues in which texels are projected.
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
 * The surface point of one pixel; all members but `hit` and `unit` are null if it shows no
 * surface.
 *
 * `position` and the outward unit `normal` are in the world, whose lengths have the `unit`,
 * empty if unknown; `sides` are the sides of a patient on which the coordinates lie, such as
 * "LAS", empty for other volumes. `voxel` are voxel indices, x first. `value` is the value of
 * the volume, null on the `wall` with that number. `light` is linear RGB, `displayed` the
 * same as a picture shows it, sRGB. `state` is final, converging or provisional, and `error`
 * the relative error of this pixel.
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
 * An isovalue with a name; `suggested` if it was found in the volume, and not given by
 * the scene.
 */
export interface Preset {
  name: string;
  isovalue: number;
  suggested: boolean;
}

/**
 * The range of a parameter, both ends included.
 */
export interface Range {
  min: number;
  max: number;
}

/**
 * A saving: an amount of a unit, measured or computed.
 */
export interface Saving {
  amount: number;
  unit: string;
  measured: boolean;
}

/**
 * One scene in the list of scenes; `volume` is the address of its volume if that was
 * uploaded.
 */
export interface SceneLink {
  id: string;
  name: string;
  href: string;
  volume: string | null;
}

/**
 * All scenes of this server, and the limits of uploads; null if it takes none.
 */
export interface SceneList {
  scenes: Array<SceneLink>;
  uploads: UploadLimits | null;
}

/**
 * All that a client needs to show a scene: facts, histogram, defaults and ranges of all
 * parameters, and the plan.
 *
 * `environment` is the id of the light that the document is about, null for the scene's;
 * `environments` are those that views may name.
 *
 * `read_only` is true if the store can only be read, so that nothing more is baked; a note of
 * the plan says so too.
 *
 * `presets` are interesting isovalues: the scene's, else boundaries between materials in the
 * volume. `stops` are ascending isovalues between which the surface moves about equally far;
 * `stops_note` says where they are evenly spaced instead, empty if nowhere. `rotating` is true
 * if the light may be rotated, `turns` if a rotation is visible: it is not if the light is the
 * same from all sides. `turn_step` is the step in degrees to which yaw, pitch and roll are
 * rounded if light is baked for each turn, null if all turns share the light that is kept.
 * `albedos` is the range that views may ask for, null if they may not. `shines` are the kinds
 * of shine that views may ask for, none if the surface is diffuse. `cuts` is true if the voxels
 * lie along the world's axes, so that planes across these may cut the volume. `colours` is the
 * scale of a surface whose albedo comes from data; `albedo` is then the most that it reflects.
 * `surfaces` are pinned isosurfaces; the sliding one lets the share `clear` of rays pass, and
 * transmits `transmission` diffusely. `material` is the present material as views spell it,
 * and `materials` are all, with reasons why some are refused. `view` holds the parameters of
 * the first view that the scene file gives.
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
  turn_step: number | null;
  view: Record<string, number | string | [number, number, number]>;
  error_scale: ErrorScale;
  plan: Plan;
  read_only: boolean;
}

/**
 * Shares of surface pixels, by state.
 */
export interface Shares {
  final: number;
  converging: number;
  provisional: number;
}

/**
 * Area of a surface and volume of the solid, in squares and cubes of the `unit`, which is
 * empty if unknown.
 *
 * `area` is 0 if there is no surface. `area_error` and `volume_error` are the uncertainties
 * due to the size of voxels, in the same units. `is_open` is true if the solid reaches a side of
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

/** The status of a job, in the words of OGC API Processes. */
export type Status = "accepted" | "running" | "successful" | "failed" | "dismissed";

/**
 * A pinned isosurface: its `name`, empty if it has none, the `albedo` of both sides,
 * linear RGB, the share of rays that pass straight through it, `clear`, and the share of
 * light that it transmits diffusely, `transmission`, linear RGB.
 */
export interface Surface {
  isovalue: number;
  name: string;
  albedo: [number, number, number];
  transmission: [number, number, number];
  clear: number;
}

/**
 * Counts of texels and chunks of the lattice, of those that some view can show, and of shown
 * texels that can hold no light (`void`).
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
 * Seconds until all pixels are final: the most likely number, and the likely range.
 */
export interface TimeLeft {
  low: number;
  likely: number;
  high: number;
}

/**
 * Limits of uploads: `limit_bytes` of one, `limit_files` in an archive, and the
 * `free_bytes` that are left of `quota_bytes` for all.
 */
export interface UploadLimits {
  limit_bytes: number;
  limit_files: number;
  quota_bytes: number;
  free_bytes: number;
}

/**
 * A volume: voxels and spacing along x, y, z; `holes` counts voxels that are not finite.
 *
 * `affine` (3, 4) maps voxel indices to the world, whose lengths have the `unit`, empty if
 * unknown. `letters` are the patient directions of the world's axes, `axes` those of the
 * voxels'; empty for other volumes. `bounds` are the least and the greatest world x, y, z.
 * `notes` say how the field of the file was changed, and `read_as` which format the file was
 * taken for, empty without a file. The volume is step `time` of a series of `times`, 0 of 1 if
 * it is no series.
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
