// One animation loop for everything on the page that moves; it rests when nothing does.

const beats = new Set();
let asked = 0;
let last = 0;
let gap = 16; // milliseconds between repaints, averaged

function beat(now) {
  asked = 0;
  if (now - last < 1000) gap += 0.05 * (now - last - gap);
  last = now;
  for (const each of [...beats]) each(now);
  if (beats.size) ask();
}

function ask() {
  if (!asked) asked = requestAnimationFrame(beat);
}

/** Calls `each(now)` before every repaint until `drop`. */
export function keep(each) {
  beats.add(each);
  ask();
}

export function drop(each) {
  beats.delete(each);
}

/** How long the page takes from one repaint to the next while something moves. */
export function pace() {
  return gap;
}
