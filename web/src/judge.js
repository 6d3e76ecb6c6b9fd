// The name under which answers are given, kept in this browser.

const KEY = "hiprl.judge";
let name = "me", known = false;
try {
  const kept = localStorage.getItem(KEY);
  known = Boolean(kept);
  name = kept || "me";
} catch {
  // storage may be switched off: the name then lasts as long as the page
}

export function judge() {
  return name;
}

/** Whether somebody said a name here. */
export function named() {
  return known;
}

export function call(it) {
  known = true;
  name = [...it.replace(/\s+/g, " ").trim()].slice(0, 60).join("") || "me"; // as the server keeps it
  try {
    localStorage.setItem(KEY, name);
  } catch {
    // as above
  }
  return name;
}
