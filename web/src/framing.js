// Where the camera stands: found once for all the clips of a question, so that they are seen alike.

const SMOOTH = 0.35; // seconds over which the followed point is averaged
const APART = 1.5; // sizes of the body between two clips' starts, from which on each is looked at by itself

/** Turns a vector by a quaternion (w, x, y, z) at `at` in `q`; the result goes into `out`. */
function turn(q, at, [x, y, z], out) {
  const w = q[at], a = q[at + 1], b = q[at + 2], c = q[at + 3];
  const tx = 2 * (b * z - c * y), ty = 2 * (c * x - a * z), tz = 2 * (a * y - b * x);
  out[0] = x + w * tx + b * tz - c * ty;
  out[1] = y + w * ty + c * tx - a * tz;
  out[2] = z + w * tz + a * ty - b * tx;
}

/** Radius of a ball about a geom's centre that holds it. */
export function reach(geom, meshes) {
  const [a, b = 0, c = 0] = geom.size;
  switch (geom.type) {
    case "sphere": return a;
    case "capsule": return a + b;
    case "cylinder": return Math.hypot(a, b);
    case "ellipsoid": return Math.max(a, b, c);
    case "mesh": return meshes?.[geom.mesh]?.radius ?? Math.hypot(a, b, c);
    default: return Math.hypot(a, b, c);
  }
}

/** For each frame the box about the moving parts, and their middle weighed by size. */
function boxes(clip, scene, parts) {
  const low = [], high = [], middle = [];
  const p = clip.poses, at = [0, 0, 0];
  for (let f = 0; f < clip.count; f++) {
    const lo = [Infinity, Infinity, Infinity], hi = [-Infinity, -Infinity, -Infinity], mid = [0, 0, 0];
    let weight = 0;
    for (const part of parts) {
      const o = (f * scene.bodies + part.body) * 7;
      for (const end of part.ends) {
        turn(p, o + 3, end, at);
        for (let i = 0; i < 3; i++) {
          const v = p[o + i] + at[i];
          lo[i] = Math.min(lo[i], v - part.radius);
          hi[i] = Math.max(hi[i], v + part.radius);
          mid[i] += v * part.weight;
        }
        weight += part.weight;
      }
    }
    low.push(lo);
    high.push(hi);
    middle.push(mid.map((v) => v / (weight || 1)));
  }
  const round = (targets) => targets.map((target, f) => {
    let most = 0;
    for (const part of parts) {
      const o = (f * scene.bodies + part.body) * 7;
      for (const end of part.ends) {
        turn(p, o + 3, end, at);
        most = Math.max(most, Math.hypot(p[o] + at[0] - target[0], p[o + 1] + at[1] - target[1]) + part.radius);
      }
    }
    return most;
  });
  return { low, high, middle, round };
}

/** Geoms that belong to a body, as balls at the ends of what they are. */
function moving(scene, meshes) {
  return scene.geoms
    .filter((g) => g.body > 0 && g.type !== "plane" && !(g.rgba && g.rgba[3] === 0))
    .map((g) => {
      const long = g.type === "capsule" || g.type === "cylinder";
      const radius = long ? g.size[0] : reach(g, meshes);
      const ends = [];
      for (const side of long ? [-1, 1] : [0]) {
        const end = [0, 0, 0];
        turn(g.quat, 0, [0, 0, side * (long ? g.size[1] : 0)], end);
        ends.push(end.map((v, i) => v + g.pos[i]));
      }
      return { body: g.body, radius, ends, weight: radius ** 2 * (long ? g.size[1] + radius : radius) + 1e-9 };
    });
}

/** Averages over time with a bell of `width` frames; the ends count as standing still. */
function smooth(values, width) {
  const half = Math.ceil(width * 2.5);
  if (half < 1) return values;
  const bell = Array.from({ length: 2 * half + 1 }, (_, i) => Math.exp(-0.5 * ((i - half) / width) ** 2));
  const sum = bell.reduce((a, b) => a + b);
  const last = values.length - 1;
  return values.map((_, f) => {
    let v = 0;
    for (let j = -half; j <= half; j++) v += bell[j + half] * values[Math.min(last, Math.max(0, f + j))];
    return v / sum;
  });
}

const spread = (values) => Math.max(...values) - Math.min(...values);
const quantile = (values, q) => [...values].sort((a, b) => a - b)[Math.round(q * (values.length - 1))];

/** 1, 2 or 5 times a power of ten, near `x`. */
export function nice(x) {
  const power = 10 ** Math.floor(Math.log10(Math.max(x, 1e-9)));
  const rest = x / power;
  return power * (rest < 1.5 ? 1 : rest < 3.5 ? 2 : rest < 7.5 ? 5 : 10);
}

/**
 * How to look at these clips.
 *
 * targets: for each clip the followed points [x, y, z] frame by frame; origins: where each clip starts.
 * box: half sizes about the followed point that hold the body, round: its radius seen from above; yaw and pitch: the first view; size: of the body;
 * lowest: the lowest point touched; travels: whether the camera follows; flat: moves in the xy plane alone.
 */
export function frame(scene, clips, meshes) {
  const parts = moving(scene, meshes);
  if (!parts.length) parts.push({ body: 0, radius: 1, ends: [[0, 0, 0]], weight: 1 });
  const all = clips.map((clip) => boxes(clip, scene, parts));
  const extents = [0, 1, 2].map((i) =>
    quantile(all.flatMap((b) => b.high.map((hi, f) => (hi[i] - b.low[f][i]) / 2)), 0.95));
  const size = Math.max(...extents);

  const width = SMOOTH / scene.dt;
  const paths = all.map((b) => [0, 1].map((i) => smooth(b.middle.map((m) => m[i]), width)));
  const travels = paths.some(([x, y]) => Math.hypot(spread(x), spread(y)) > 0.7 * size);

  // what hardly moves, and far from each other, is looked at where it is: where they are near, where is part of it
  const starts = all.map((b) => b.middle[0]);
  const apart = (a) => starts.some((b) => Math.hypot(a[0] - b[0], a[1] - b[1]) > APART * size);
  const shifts = starts.map((start) => (!travels && starts.some(apart) ? [start[0], start[1], 0] : [0, 0, 0]));
  const shifted = (boxes, c) => boxes.map((v) => v.map((x, i) => x - shifts[c][i]));
  const lows = all.flatMap((b, c) => shifted(b.low, c)), highs = all.flatMap((b, c) => shifted(b.high, c));
  const lowest = Math.min(...lows.map((v) => v[2]));
  const whole = [0, 1, 2].map((i) => [Math.min(...lows.map((v) => v[i])), Math.max(...highs.map((v) => v[i]))]);
  const bottom = quantile(lows.map((v) => v[2]), 0.01), top = quantile(highs.map((v) => v[2]), 0.99);
  const height = (bottom + top) / 2;
  const targets = paths.map(([x, y], c) => travels
    ? x.map((v, f) => [v, y[f], height])
    : x.map(() => whole.map(([a, b], i) => (a + b) / 2 + shifts[c][i])));
  const box = [0, 1].map((i) => travels
    ? quantile(all.flatMap((b, c) => b.high.map((hi, f) =>
      Math.max(hi[i] - targets[c][f][i], targets[c][f][i] - b.low[f][i]))), 0.97)
    : (whole[i][1] - whole[i][0]) / 2);
  box.push(travels ? (top - bottom) / 2 : (whole[2][1] - whole[2][0]) / 2);

  // the farthest that anything gets from the followed point, seen from above
  const round = quantile(all.flatMap((b, c) => b.round(targets[c])), 0.98);

  const sway = [0, 1, 2].map((i) => Math.max(...clips.map((clip) => swayOf(clip, scene, parts, i))));
  const planar = sway[1] < 0.02 * size; // all in the xz plane: runners in two dimensions
  const flat = !planar && sway[2] < 0.02 * size; // all in the xy plane: arms on a table
  const run = [0, 1].map((i) => Math.max(...paths.map((p) => Math.abs(p[i].at(-1) - p[i][0]))));
  const across = !planar && !flat && travels && run[1] > 2.5 * run[0] && run[1] > 2 * size;
  const yaw = planar ? -90 : flat ? -90 : across ? 20 : -65; // degrees; the camera stands there, seen from the target
  const pitch = planar ? 12 : flat ? 62 : 20;
  return {
    targets, origins: starts, box, round, size, lowest, travels, flat, yaw, pitch,
  };
}

/** How far the parts of a clip move along axis i over its time. */
function swayOf(clip, scene, parts, i) {
  let most = 0;
  for (const { body } of parts) {
    let lo = Infinity, hi = -Infinity;
    for (let f = 0; f < clip.count; f++) {
      const v = clip.poses[(f * scene.bodies + body) * 7 + i];
      lo = Math.min(lo, v);
      hi = Math.max(hi, v);
    }
    most = Math.max(most, hi - lo);
  }
  return most;
}
