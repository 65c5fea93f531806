/** Planes that take away what lies there, as frame requests spell them: `x>40;z<10`, and what they leave along each axis. */

/** @typedef {[number, number]} Kept what is left along an axis, from one world coordinate to another */

/** The world's axes, by which planes may be named. */
export const AXES = ["x", "y", "z"];

const NUMBER = "[+-]?(?:\\d+\\.?\\d*|\\.\\d+)(?:[eE][+-]?\\d+)?";
const TERM = new RegExp(`^(?:([xyz])|${NUMBER},${NUMBER},${NUMBER})([<>])(${NUMBER})$`);
const MOST = 12;

/**
 * Whether a text spells planes.
 * @param {unknown} text
 * @returns {text is string}
 */
export function arePlanes(text) {
  if (typeof text !== "string") return false;
  const terms = termsOf(text);
  return terms.length > 0 && terms.length <= MOST && terms.every((term) => TERM.test(term));
}

/**
 * What planes leave along the world's axes within `bounds`, and the planes that are along none of them.
 * @param {string} text
 * @param {[number[], number[]]} bounds the least and the greatest coordinates
 * @returns {{kept: Kept[], others: string[]}}
 */
export function readPlanes(text, [low, high]) {
  /** @type {Kept[]} */
  const kept = low.map((from, axis) => [from, high[axis]]);
  /** @type {string[]} */
  const others = [];
  for (const term of termsOf(text)) {
    const [, name, sign, limit] = TERM.exec(term) ?? [];
    const range = kept[AXES.indexOf(name)];
    if (!range) others.push(term);
    else if (sign === "<") range[0] = Math.min(Math.max(range[0], Number(limit)), range[1]);
    else range[1] = Math.max(Math.min(range[1], Number(limit)), range[0]);
  }
  return { kept, others };
}

/**
 * The text of planes; "" where all is left.
 * @param {{kept: Kept[], others: string[]}} planes
 * @param {[number[], number[]]} bounds
 * @returns {string}
 */
export function writePlanes({ kept, others }, [low, high]) {
  const terms = kept.flatMap(([from, to], axis) => [
    ...(from > low[axis] ? [`${AXES[axis]}<${from}`] : []),
    ...(to < high[axis] ? [`${AXES[axis]}>${to}`] : []),
  ]);
  return [...terms, ...others].join(";");
}

/** @param {string} text */
function termsOf(text) {
  return text.split(";").map((term) => term.replaceAll(" ", "")).filter(Boolean);
}
