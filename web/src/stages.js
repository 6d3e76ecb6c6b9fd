// What draws clips of one kind: bodies in 3-D, pictures, or plain states. All have the same methods.

import { PerspectiveCamera } from "three";
import { World } from "./bodies.js";
import { frame } from "./framing.js";
import { painter } from "./painter.js";

const FOV = 28;
const night = matchMedia("(prefers-color-scheme: dark)");
const worlds = new WeakMap(); // scene -> its world, while the colours stay

function worldOf(scene) {
  const known = worlds.get(scene);
  if (known && known.dark === night.matches) return known.world;
  const world = new World(scene, { dark: night.matches, anisotropy: painter().anisotropy });
  worlds.set(scene, { world, dark: night.matches });
  return world;
}

class BodyStage {
  turns = true;

  constructor(scene) {
    this.scene = scene;
    this.camera = new PerspectiveCamera(FOV, 1, 0.01, 100);
    this.camera.up.set(0, 0, 1);
    this.orbit = { yaw: 0, pitch: 0, near: 1 };
    worldOf(scene);
  }

  get slow() {
    return painter().slow;
  }

  get ratio() {
    return painter().ratio;
  }

  load(clips) {
    this.clips = clips;
    this.view = frame(this.scene, clips, worldOf(this.scene).meshes);
  }

  turn(yaw, pitch) {
    this.orbit.yaw += yaw;
    this.orbit.pitch += pitch;
  }

  zoom(by) {
    this.orbit.near = Math.min(4, Math.max(0.25, this.orbit.near * by));
  }

  reset() {
    this.orbit = { yaw: 0, pitch: 0, near: 1 };
  }

  get turned() {
    const { yaw, pitch, near } = this.orbit;
    return Boolean(yaw || pitch || near !== 1);
  }

  /** Distance from which the box about the body fills a picture of this shape. */
  #distance(yaw, pitch, aspect) {
    const [x, y, z] = this.view.box;
    const { round } = this.view;
    const across = Math.min(round, Math.abs(Math.sin(yaw)) * x + Math.abs(Math.cos(yaw)) * y);
    const along = Math.min(round, Math.abs(Math.cos(yaw)) * x + Math.abs(Math.sin(yaw)) * y);
    const up = Math.cos(pitch) * z + Math.abs(Math.sin(pitch)) * along;
    const tan = Math.tan((FOV / 2) * (Math.PI / 180));
    const margin = 1.16;
    return margin * Math.max(up / tan, across / (tan * aspect)) + along * Math.cos(pitch) * 0.6;
  }

  draw(canvas, index, seconds) {
    const world = worldOf(this.scene);
    const clip = this.clips[index];
    const at = Math.min(clip.count - 1, Math.max(0, seconds / this.scene.dt));
    const path = this.view.targets[index];
    const f = Math.floor(at), g = Math.min(path.length - 1, f + 1), t = at - f;
    const target = path[f].map((v, i) => v + t * (path[g][i] - v));
    if (!this.view.flat) target[2] -= 0.1 * this.view.size; // a little more ground than sky

    const radians = Math.PI / 180;
    const yaw = (this.view.yaw + this.orbit.yaw) * radians;
    const pitch = Math.min(88, Math.max(-4, this.view.pitch + this.orbit.pitch)) * radians;
    this.orbit.pitch = pitch / radians - this.view.pitch;
    const distance = this.#distance(this.view.yaw * radians, this.view.pitch * radians, canvas.width / canvas.height) / this.orbit.near;
    const { size, lowest, origins } = this.view;
    const z = world.level(lowest, size);
    world.pose(clip, at);
    world.cast(z);
    world.ground.fit(this.view);
    world.ground.place(target, origins[index], z, { yaw });
    this.camera.aspect = canvas.width / canvas.height;
    this.camera.near = distance * 0.05;
    this.camera.far = distance * 12;
    this.camera.position.set(
      target[0] + distance * Math.cos(pitch) * Math.cos(yaw),
      target[1] + distance * Math.cos(pitch) * Math.sin(yaw),
      Math.max(z + 0.02 * distance, target[2] + distance * Math.sin(pitch)));
    this.camera.lookAt(...target);
    this.camera.updateProjectionMatrix();
    world.three.fog.near = distance * 1.4;
    world.three.fog.far = distance * 1.4 + world.ground.cell * 18;
    painter().draw(canvas, world, this.camera);
  }

  flush() {
    painter().flush();
  }
}

class PictureStage {
  turns = false;
  slow = false;

  get ratio() {
    return Math.min(2, window.devicePixelRatio || 1);
  }

  constructor(scene) {
    this.scene = scene;
  }

  load(clips) {
    this.clips = clips;
    this.ready = Promise.all(clips.flatMap((clip) => clip.images.map((image) => image.decode().catch(() => {}))));
  }

  draw(canvas, index, seconds) {
    const { images, count } = this.clips[index];
    const image = images[Math.min(count - 1, Math.max(0, Math.round(seconds / this.scene.dt)))];
    const pen = canvas.getContext("2d");
    pen.clearRect(0, 0, canvas.width, canvas.height);
    if (!image?.naturalWidth) return;
    const scale = Math.min(canvas.width / image.naturalWidth, canvas.height / image.naturalHeight);
    const w = image.naturalWidth * scale, h = image.naturalHeight * scale;
    pen.imageSmoothingQuality = "high";
    pen.drawImage(image, (canvas.width - w) / 2, (canvas.height - h) / 2, w, h);
  }
}

const MOST = 24; // state entries that are drawn

class StateStage {
  turns = false;
  slow = false;

  get ratio() {
    return Math.min(2, window.devicePixelRatio || 1);
  }

  constructor(scene) {
    this.scene = scene;
  }

  load(clips) {
    this.clips = clips;
    const width = Math.min(MOST, clips[0]?.width ?? 0);
    this.span = Math.max(...clips.map((clip) => clip.count - 1), 1);
    this.ranges = Array.from({ length: width }, (_, i) => {
      let lo = Infinity, hi = -Infinity;
      for (const clip of clips) {
        for (let f = 0; f < clip.count; f++) {
          lo = Math.min(lo, clip.states[f * clip.width + i]);
          hi = Math.max(hi, clip.states[f * clip.width + i]);
        }
      }
      const pad = (hi - lo) * 0.08 || 0.5;
      return [lo - pad, hi + pad];
    });
  }

  draw(canvas, index, seconds) {
    const clip = this.clips[index];
    const pen = canvas.getContext("2d");
    const style = getComputedStyle(canvas);
    const ink = style.color, accent = style.getPropertyValue("--accent").trim() || "#2b7a68";
    const ratio = this.ratio;
    pen.clearRect(0, 0, canvas.width, canvas.height);
    const n = this.ranges.length;
    const columns = n > 12 ? 3 : n > 5 ? 2 : 1;
    const rows = Math.ceil(n / columns);
    const gap = 10 * ratio, pad = 10 * ratio, top = 34 * ratio;
    const w = (canvas.width - 2 * pad - (columns - 1) * gap) / columns;
    const h = (canvas.height - top - pad - (rows - 1) * gap) / rows;
    const at = Math.min(clip.count - 1, Math.max(0, seconds / this.scene.dt));
    this.ranges.forEach(([lo, hi], i) => {
      const x0 = pad + Math.floor(i / rows) * (w + gap), y0 = top + (i % rows) * (h + gap);
      const x = (f) => x0 + (f / this.span) * w;
      const y = (v) => y0 + h - ((v - lo) / (hi - lo)) * h;
      const value = (f) => clip.states[f * clip.width + i];
      pen.globalAlpha = 0.07;
      pen.fillStyle = ink;
      pen.fillRect(x0, y0, w, h);
      pen.globalAlpha = 0.45;
      pen.strokeStyle = ink;
      pen.lineWidth = ratio;
      pen.beginPath();
      for (let f = 0; f < clip.count; f++) pen.lineTo(x(f), y(value(f)));
      pen.stroke();
      pen.globalAlpha = 1;
      pen.strokeStyle = accent;
      pen.lineWidth = 2 * ratio;
      pen.beginPath();
      for (let f = 0; f <= Math.floor(at); f++) pen.lineTo(x(f), y(value(f)));
      pen.stroke();
      pen.fillStyle = accent;
      pen.beginPath();
      pen.arc(x(Math.floor(at)), y(value(Math.floor(at))), 3.5 * ratio, 0, 7);
      pen.fill();
      pen.globalAlpha = 0.75;
      pen.fillStyle = ink;
      pen.font = `${11 * ratio}px system-ui, sans-serif`;
      pen.fillText(this.scene.names?.[i] ?? `value ${i + 1}`, x0 + 4 * ratio, y0 + 13 * ratio, w - 8 * ratio);
      pen.globalAlpha = 1;
    });
  }
}

/** The stage for clips of this scene; without WebGL a scene with bodies cannot be drawn and says so. */
export function stageOf(scene) {
  if (scene.kind === "mujoco") return new BodyStage(scene);
  if (scene.kind === "frames") return new PictureStage(scene);
  return new StateStage(scene);
}
