// The one WebGL context of a page: draws a world from a camera and copies the picture to where it is shown.

import { WebGLRenderer } from "three";
import { pace } from "./ticker.js";

const MOST = 4096; // pixels across

let made = null;

function weak(gl) {
  const info = gl.getExtension("WEBGL_debug_renderer_info");
  const name = String(gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
  return /swiftshader|llvmpipe|software|basic render/i.test(name);
}

class Painter {
  constructor() {
    const probe = document.createElement("canvas").getContext("webgl2");
    if (!probe) throw new Error("no WebGL");
    this.slow = weak(probe);
    probe.getExtension("WEBGL_lose_context")?.loseContext();
    this.renderer = new WebGLRenderer({ antialias: !this.slow, stencil: true, powerPreference: "low-power" });
    this.anisotropy = this.slow ? 1 : Math.min(8, this.renderer.capabilities.getMaxAnisotropy());
    this.renderer.setPixelRatio(1);
    this.renderer.setScissorTest(true);
    this.width = this.height = 0;
    this.pending = []; // drawn side by side, not copied yet
    this.began = null;
    this.cost = 0; // milliseconds a picture takes, averaged
    this.judged = performance.now();
    this.share = 1; // of the full resolution, less where pictures take long
  }

  get ratio() {
    return this.slow ? this.share : Math.min(2, window.devicePixelRatio || 1);
  }

  /** Draws what `canvas` will show at the next `flush`; it has its size in device pixels already. */
  draw(canvas, world, camera) {
    const { width, height } = canvas;
    const left = this.pending.reduce((sum, one) => sum + one.width, 0);
    if (left + width > this.width || height > this.height) {
      this.flush(); // a new size wipes what is there
      this.width = Math.min(MOST, Math.max(left + width, this.width));
      this.height = Math.max(height, this.height);
      this.renderer.setSize(this.width, this.height, false);
    }
    const x = this.pending.reduce((sum, one) => sum + one.width, 0);
    this.began ??= performance.now();
    this.renderer.setViewport(x, 0, width, height);
    this.renderer.setScissor(x, 0, width, height);
    this.renderer.render(world.three, camera);
    this.pending.push(canvas);
  }

  /** Copies everything drawn to where it is shown: waiting for the graphics once is cheaper than for each picture. */
  flush() {
    let x = 0;
    for (const canvas of this.pending) {
      const { width, height } = canvas;
      canvas.getContext("2d", { alpha: false }).drawImage(
        this.renderer.domElement, x, this.height - height, width, height, 0, 0, width, height);
      x += width;
    }
    if (!this.pending.length) return;
    this.cost += 0.1 * ((performance.now() - this.began) / this.pending.length - this.cost);
    this.pending = [];
    this.began = null;
    if (this.cost > 14) this.slow = true;
    const now = performance.now();
    if (!this.slow || now - this.judged < 3000) return;
    this.judged = now;
    if (pace() > 50) this.share = Math.max(0.56, this.share * 0.75);
    else if (pace() < 20) this.share = Math.min(1, this.share / 0.75);
  }
}

/** The page's painter; throws where the browser has no WebGL. */
export function painter() {
  made ??= new Painter();
  return made;
}
