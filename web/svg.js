/** Elements of drawings. */

const NAMESPACE = "http://www.w3.org/2000/svg";

/**
 * An SVG element with its attributes, and the text in it.
 * @param {string} tag
 * @param {Record<string, string|number>} attributes
 * @param {string} [text]
 * @returns {SVGElement}
 */
export function make(tag, attributes, text = "") {
  const node = document.createElementNS(NAMESPACE, tag);
  Object.entries(attributes).forEach(([name, value]) => node.setAttribute(name, value));
  node.textContent = text;
  return node;
}
