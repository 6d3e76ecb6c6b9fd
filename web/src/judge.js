// The name under which answers are given, kept in this browser. Who says none is "me", with a mark of this browser's
// own: two who say none are two.

const KEY = "hiprl.judge", MARK = "hiprl.mark";

function kept(key) {
  try {
    return localStorage.getItem(key);
  } catch {
    return null; // storage may be switched off: names then last as long as the page
  }
}

function keep(key, value) {
  try {
    localStorage.setItem(key, value);
  } catch {
    // as above
  }
  return value;
}

const nobody = `me-${kept(MARK) ?? keep(MARK, Math.random().toString(36).slice(2, 6))}`;
let known = Boolean(kept(KEY));
let name = kept(KEY) || nobody;

export function judge() {
  return name;
}

/** The same as its owner reads it. */
export function myself() {
  return name === nobody ? "me" : name;
}

/** Whether somebody said a name here. */
export function named() {
  return known;
}

export function call(it) {
  known = true;
  name = [...it.replace(/\s+/g, " ").trim()].slice(0, 60).join("") || nobody; // as the server keeps it
  return keep(KEY, name);
}
