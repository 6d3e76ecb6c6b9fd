// A checkered ground with distance lines that never ends, and an arrow for forwards.

import {
  Color, DataTexture, DoubleSide, Group, LinearFilter, LinearMipmapLinearFilter, Mesh, MeshBasicMaterial,
  PlaneGeometry, RepeatWrapping, SRGBColorSpace, Shape, ShapeGeometry, Sprite, SpriteMaterial, CanvasTexture,
} from "three";
import { nice } from "./framing.js";

const CELLS = 48; // across the drawn piece of ground
const LINES = 11; // distance lines that are drawn at once

function checkers(light, dark) {
  const n = 64;
  const data = new Uint8Array(n * n * 4);
  const tones = [new Color(light), new Color(dark)].map((c) => {
    const hex = c.getHex(SRGBColorSpace);
    return [hex >> 16, (hex >> 8) & 255, hex & 255, 255];
  });
  for (let y = 0; y < n; y++) {
    for (let x = 0; x < n; x++) data.set(tones[(x < n / 2) === (y < n / 2) ? 0 : 1], (y * n + x) * 4);
  }
  const texture = new DataTexture(data, n, n);
  texture.colorSpace = SRGBColorSpace;
  texture.wrapS = texture.wrapT = RepeatWrapping;
  texture.magFilter = LinearFilter;
  texture.minFilter = LinearMipmapLinearFilter;
  texture.generateMipmaps = true;
  texture.repeat.set(CELLS / 2, CELLS / 2);
  texture.needsUpdate = true;
  return texture;
}

/** Words as a picture that always faces the camera. */
function words(text, ink, cache) {
  const known = cache.get(text);
  if (known) return known;
  const canvas = document.createElement("canvas");
  const height = 64;
  const font = `600 ${height * 0.6}px system-ui, sans-serif`;
  let pen = canvas.getContext("2d");
  pen.font = font;
  canvas.width = Math.ceil(pen.measureText(text).width) + 16;
  canvas.height = height;
  pen = canvas.getContext("2d");
  pen.font = font;
  pen.textBaseline = "middle";
  pen.fillStyle = ink;
  pen.fillText(text, 8, height / 2);
  const map = new CanvasTexture(canvas);
  map.colorSpace = SRGBColorSpace;
  const made = { map, ratio: canvas.width / height };
  cache.set(text, made);
  return made;
}

export class Ground extends Group {
  constructor(look, anisotropy) {
    super();
    this.look = look;
    this.cache = new Map();
    this.texture = checkers(look.light, look.dark);
    this.texture.anisotropy = anisotropy;
    this.plane = new Mesh(new PlaneGeometry(1, 1), new MeshBasicMaterial({ map: this.texture, depthWrite: false }));
    this.plane.renderOrder = -3;
    this.add(this.plane);
    this.lines = Array.from({ length: LINES }, () => {
      const line = new Mesh(new PlaneGeometry(1, 1), new MeshBasicMaterial({ color: look.line, depthWrite: false, transparent: true }));
      line.renderOrder = -2;
      const label = new Sprite(new SpriteMaterial({ transparent: true, depthWrite: false, fog: true }));
      this.add(line, label);
      return { line, label };
    });
    this.arrow = this.#arrow();
    this.add(this.arrow);
  }

  #arrow() {
    const shape = new Shape();
    [[-1, -0.11], [0.42, -0.11], [0.42, -0.32], [1, 0], [0.42, 0.32], [0.42, 0.11], [-1, 0.11]]
      .forEach(([x, y], i) => (i ? shape.lineTo(x, y) : shape.moveTo(x, y)));
    const arrow = new Group();
    const flat = new Mesh(new ShapeGeometry(shape), new MeshBasicMaterial({ color: this.look.forward, side: DoubleSide, depthWrite: false, transparent: true, opacity: 0.9 }));
    flat.renderOrder = -1;
    arrow.add(flat);
    return arrow;
  }

  /** Sets grid and lines for a body of this size. */
  fit({ size, flat, travels, box }) {
    this.cell = nice(size * 0.6);
    this.step = nice(size * 2);
    this.size = size;
    this.depth = box[1];
    this.flat = flat;
    this.plane.scale.set(this.cell * CELLS, this.cell * CELLS, 1);
    this.arrow.visible = !flat;
    this.marked = !flat && travels;
  }

  /** Lies under `target` at height z; distances count from `origin`. */
  place(target, origin, z, view) {
    const two = 2 * this.cell;
    this.plane.position.set(
      origin[0] + two * Math.round((target[0] - origin[0]) / two),
      origin[1] + two * Math.round((target[1] - origin[1]) / two), z);
    const lift = this.size * 0.004;
    const middle = Math.round((target[0] - origin[0]) / this.step);
    const side = Math.sign(Math.sin(view.yaw)) || 1; // the side away from the camera gets the numbers
    this.lines.forEach(({ line, label }, i) => {
      line.visible = label.visible = this.marked;
      if (!this.marked) return;
      const k = middle + i - (LINES - 1) / 2;
      const x = origin[0] + k * this.step;
      line.position.set(x, this.plane.position.y, z + lift);
      line.scale.set(this.size * (k ? 0.022 : 0.05), this.cell * CELLS * 0.5, 1);
      line.material.color.set(k ? this.look.line : this.look.start);
      line.material.opacity = k ? 0.75 : 0.9;
      const away = Number((k * this.step).toPrecision(6));
      const { map, ratio } = words(k ? `${away} m` : "start", k ? this.look.ink : this.look.start, this.cache);
      if (label.material.map !== map) {
        label.material.map = map;
        label.material.needsUpdate = true;
      }
      const tall = this.size * 0.22;
      label.scale.set(tall * ratio, tall, 1);
      label.position.set(x, origin[1] - side * (this.depth + this.size * 1.5), z + tall * 0.6);
    });
    if (this.arrow.visible) {
      const near = this.depth + this.size * 0.34;
      const scale = this.size * 0.34;
      this.arrow.position.set(
        target[0] + Math.cos(view.yaw) * near, target[1] + Math.sin(view.yaw) * near, z + lift * 2);
      this.arrow.scale.set(scale, scale, 1);
    }
  }
}
