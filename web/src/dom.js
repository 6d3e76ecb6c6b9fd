// Making elements; words go in as text, never as HTML.

/** An element: `make("p.note", { hidden: true }, "words", child)`. */
export function make(what, attributes = {}, ...children) {
  const [tag, ...classes] = what.split(".");
  const element = document.createElement(tag);
  if (classes.length) element.className = classes.join(" ");
  return fill(element, attributes, children);
}

/** The same for a part of an SVG picture. */
export function draw(what, attributes = {}, ...children) {
  const [tag, ...classes] = what.split(".");
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  if (classes.length) element.setAttribute("class", classes.join(" "));
  return fill(element, attributes, children);
}

function fill(element, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (typeof value === "boolean" && !name.startsWith("aria-")) element.toggleAttribute(name, value);
    else if (value !== null && value !== undefined) element.setAttribute(name, String(value));
  }
  element.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return element;
}

/** Puts others in the place of what is in an element; the one with the same `data-key` takes over the focus. */
export function renew(element, ...children) {
  const key = element.contains(document.activeElement) ? document.activeElement.dataset.key : undefined;
  element.replaceChildren(...children);
  if (key !== undefined) [...element.querySelectorAll("[data-key]")].find((one) => one.dataset.key === key)?.focus();
}

export function find(id) {
  return document.getElementById(id);
}

/** Sets words only where they differ, so that nothing is read out twice. */
export function write(element, text) {
  if (element && element.textContent !== text) element.textContent = text;
}

/** Reads words out to those who do not see the page. */
export function announce(text) {
  write(find("live"), text);
}

export const pause = (ms) => new Promise((done) => setTimeout(done, ms));
