/** Elements of the page: found with the type that they must have, or made. */

const SVG = "http://www.w3.org/2000/svg";

/**
 * The first element that a selector finds.
 * @template {Element} [T=HTMLElement]
 * @param {ParentNode} root
 * @param {string} selector
 * @param {new (...args: any[]) => T} [kind] class of the element, `HTMLElement` where it is left
 *   out
 * @returns {T}
 * @throws {TypeError} where there is none of that class: the page and its modules do not fit
 */
export function find(root, selector, kind = /** @type {any} */ (HTMLElement)) {
  const node = root.querySelector(selector);
  if (node instanceof kind) return node;
  throw new TypeError(`no ${kind.name} at ${selector}`);
}

/**
 * An element with text in it.
 * @template {keyof HTMLElementTagNameMap} T
 * @param {T} tag
 * @param {string|number} text
 * @returns {HTMLElementTagNameMap[T]}
 */
export function textElement(tag, text) {
  return Object.assign(document.createElement(tag), { textContent: String(text) });
}

/**
 * An SVG element with its attributes, and the text in it.
 * @template {keyof SVGElementTagNameMap} T
 * @param {T} tag
 * @param {Record<string, string|number>} attributes
 * @param {string} [text]
 * @returns {SVGElementTagNameMap[T]}
 */
export function svgElement(tag, attributes, text = "") {
  const node = document.createElementNS(SVG, tag);
  Object.entries(attributes).forEach(([name, value]) => node.setAttribute(name, String(value)));
  node.textContent = text;
  return node;
}

/** @type {WeakMap<Element, {width: number, height: number}>} */
const SIZES = new WeakMap();
/** @type {ResizeObserver|null} */
let watching = null;

/**
 * The size of an element's box inside its border, CSS pixels, as it was last laid out: to ask the
 * element itself would
 * have the page laid out at once.
 * @param {Element} element one that stays on the page
 * @returns {{width: number, height: number}}
 */
export function sizeOf(element) {
  watching ??= new ResizeObserver((changes) => changes.forEach(({ target }) => measure(target)));
  const known = SIZES.get(element);
  if (!known) watching.observe(element);
  return known ?? measure(element);
}

/** @param {Element} element */
function measure(element) {
  const size = { width: element.clientWidth, height: element.clientHeight };
  SIZES.set(element, size);
  return size;
}

/**
 * Keep as many elements in a list as are wanted: the last ones go, new ones are made.
 * @template {Element} T
 * @param {T[]} elements
 * @param {number} count
 * @param {(k: number) => T} make
 */
export function resize(elements, count, make) {
  while (elements.length > count) elements.pop()?.remove();
  while (elements.length < count) elements.push(make(elements.length));
}
