/** Elements of the page: found with the type that they must have, or made. */

const SVG = "http://www.w3.org/2000/svg";

/**
 * Return the first element that a selector finds.
 * @template {Element} [T=HTMLElement]
 * @param {ParentNode} root
 * @param {string} selector
 * @param {new (...args: any[]) => T} [kind] class of the element, `HTMLElement` by default
 * @returns {T}
 * @throws {TypeError} if there is no element of this class: page and modules do not fit together
 */
export function find(root, selector, kind = /** @type {any} */ (HTMLElement)) {
  const node = root.querySelector(selector);
  if (node instanceof kind) return node;
  throw new TypeError(`The page has no ${kind.name} that matches ${selector}.`);
}

/**
 * Make an element with text in it.
 * @template {keyof HTMLElementTagNameMap} T
 * @param {T} tag
 * @param {string|number} text
 * @returns {HTMLElementTagNameMap[T]}
 */
export function textElement(tag, text) {
  return Object.assign(document.createElement(tag), { textContent: String(text) });
}

/**
 * Make an SVG element with attributes, and text in it.
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

/** Last known sizes. @type {WeakMap<Element, {width: number, height: number}>} */
const SIZES = new WeakMap();

/** Keeps SIZES up to date. @type {ResizeObserver|null} */
let watching = null;

/**
 * Return the size of an element inside its border, in CSS pixels, as it was last laid out. Asking
 * the element itself would force the browser to lay the page out at once.
 * @param {Element} element one that is never removed from the page
 * @returns {{width: number, height: number}}
 */
export function sizeOf(element) {
  watching ??= new ResizeObserver((changes) => changes.forEach(({ target }) => measure(target)));
  const known = SIZES.get(element);
  if (!known) watching.observe(element);
  return known ?? measure(element);
}

/** Measure an element, and keep its size. @param {Element} element */
function measure(element) {
  const size = { width: element.clientWidth, height: element.clientHeight };
  SIZES.set(element, size);
  return size;
}

/**
 * Adjust the number of elements in a list: remove the last ones, or make new ones.
 * @template {Element} T
 * @param {T[]} elements
 * @param {number} count
 * @param {(k: number) => T} make makes element number k
 */
export function resize(elements, count, make) {
  while (elements.length > count) elements.pop()?.remove();
  while (elements.length < count) elements.push(make(elements.length));
}
