// The simulated bodies as three.js objects, posed from world poses.

import {
  AmbientLight, BoxGeometry, BufferAttribute, BufferGeometry, CapsuleGeometry, Color, CylinderGeometry,
  DirectionalLight, EqualStencilFunc, Fog, Group, HemisphereLight, IncrementStencilOp, Matrix4, Mesh,
  MeshBasicMaterial, MeshLambertMaterial, Quaternion, SRGBColorSpace, Scene, SphereGeometry,
} from "three";
import { floats, integers } from "./decode.js";
import { Ground } from "./ground.js";

const LIGHT = [-0.3, -0.3, 1]; // the shadow falls away from there

const DAY = {
  sky: "#e8eef4", light: "#dde4eb", dark: "#cdd6df", line: "#93a2b2", ink: "#5f6f80", start: "#2b7a68", forward: "#2b7a68",
  shade: 0.26, hemisphere: 2.1, sun: 1.9,
};
const NIGHT = {
  sky: "#46505d", light: "#556170", dark: "#4a5563", line: "#8593a3", ink: "#b3c0cd", start: "#7fd6c0", forward: "#7fd6c0",
  shade: 0.36, hemisphere: 1.9, sun: 1.8,
};

function shape(geom, meshes) {
  const [a, b, c] = geom.size;
  switch (geom.type) {
    case "sphere": return new SphereGeometry(a, 24, 16);
    case "ellipsoid": return new SphereGeometry(1, 24, 16).scale(a, b, c);
    case "capsule": return new CapsuleGeometry(a, 2 * b, 8, 20).rotateX(Math.PI / 2);
    case "cylinder": return new CylinderGeometry(a, a, 2 * b, 28).rotateX(Math.PI / 2);
    case "box": return new BoxGeometry(2 * a, 2 * b, 2 * c);
    case "mesh": return meshes[geom.mesh]?.shape ?? null;
    default: return null;
  }
}

/** Meshes as geometries, each with the radius about its origin. */
function unpackMeshes(list) {
  return (list ?? []).map(({ vertices, faces }) => {
    const made = new BufferGeometry();
    made.setAttribute("position", new BufferAttribute(floats(vertices), 3));
    made.setIndex(new BufferAttribute(integers(faces), 1));
    const flat = made.toNonIndexed(); // flat faces: MuJoCo's corners stay sharp
    flat.computeVertexNormals();
    flat.computeBoundingSphere();
    const ball = flat.boundingSphere;
    return { shape: flat, radius: ball.center.length() + ball.radius };
  });
}

/** A whole scene: light, ground, bodies and their shadows on the ground. */
export class World {
  constructor(scene, { dark, anisotropy }) {
    this.bodyCount = scene.bodies;
    this.meshes = unpackMeshes(scene.meshes);
    this.look = dark ? NIGHT : DAY;
    this.three = new Scene();
    this.three.background = new Color(this.look.sky);
    this.three.fog = new Fog(this.look.sky, 1, 2);
    this.three.add(new HemisphereLight("#ffffff", dark ? "#6b7380" : "#a9b2bc", this.look.hemisphere));
    this.three.add(new AmbientLight("#ffffff", 0.25));
    const sun = new DirectionalLight("#ffffff", this.look.sun);
    sun.position.set(-0.5, -0.9, 1.2);
    this.three.add(sun);

    const floors = scene.geoms.filter((g) => g.type === "plane" && g.body === 0);
    this.floor = floors.length ? Math.min(...floors.map((g) => g.pos[2])) : null;
    this.ground = new Ground(this.look, anisotropy);
    this.three.add(this.ground);

    this.shadow = new Group();
    this.shadow.matrixAutoUpdate = false;
    this.three.add(this.shadow);
    const dim = new MeshBasicMaterial({
      color: "#10161d", transparent: true, opacity: this.look.shade, depthWrite: false, fog: true,
      stencilWrite: true, stencilRef: 0, stencilFunc: EqualStencilFunc, stencilZPass: IncrementStencilOp,
    });

    const skins = new Map();
    this.bodies = Array.from({ length: scene.bodies }, () => [new Group(), new Group()]);
    for (const [body, cast] of this.bodies) {
      this.three.add(body);
      this.shadow.add(cast);
    }
    for (const geom of scene.geoms) {
      const rgba = geom.rgba ?? [0.6, 0.6, 0.6, 1];
      if (geom.type === "plane" || rgba[3] === 0 || !this.bodies[geom.body]) continue;
      const form = shape(geom, this.meshes);
      if (!form) continue;
      const skin = rgba.join();
      if (!skins.has(skin)) {
        skins.set(skin, new MeshLambertMaterial({
          color: new Color().setRGB(rgba[0], rgba[1], rgba[2], SRGBColorSpace),
          transparent: rgba[3] < 1, opacity: rgba[3],
        }));
      }
      const place = (mesh) => {
        mesh.position.set(...geom.pos);
        mesh.quaternion.set(geom.quat[1], geom.quat[2], geom.quat[3], geom.quat[0]);
        return mesh;
      };
      const [body, cast] = this.bodies[geom.body];
      body.add(place(new Mesh(form, skins.get(skin))));
      const thrown = place(new Mesh(form, dim));
      thrown.renderOrder = 1;
      thrown.frustumCulled = false;
      cast.add(thrown);
    }
    this.a = new Quaternion();
    this.b = new Quaternion();
  }

  /** Height of the ground under clips whose lowest point is `lowest`. */
  level(lowest, size) {
    return this.floor ?? lowest - 0.25 * size;
  }

  /** Throws shadows on the plane at height z. */
  cast(z) {
    const [x, y, up] = LIGHT;
    const lift = 0.004;
    // p + (z - p_z) / up * light: slides along the light down to the plane
    this.shadow.matrix.copy(new Matrix4().set(
      1, 0, -x / up, (x / up) * z,
      0, 1, -y / up, (y / up) * z,
      0, 0, 0, z + lift,
      0, 0, 0, 1));
    this.shadow.matrixWorldNeedsUpdate = true;
  }

  /** Poses all bodies as at a time between two frames. */
  pose({ poses, count }, at) {
    const first = Math.min(count - 1, Math.floor(at));
    const second = Math.min(count - 1, first + 1);
    const t = Math.min(1, Math.max(0, at - first));
    for (let i = 0; i < this.bodyCount; i++) {
      const o = (first * this.bodyCount + i) * 7, n = (second * this.bodyCount + i) * 7;
      this.a.set(poses[o + 4], poses[o + 5], poses[o + 6], poses[o + 3]);
      if (t > 0) this.a.slerp(this.b.set(poses[n + 4], poses[n + 5], poses[n + 6], poses[n + 3]), t);
      for (const group of this.bodies[i]) {
        group.position.set(
          poses[o] + t * (poses[n] - poses[o]),
          poses[o + 1] + t * (poses[n + 1] - poses[o + 1]),
          poses[o + 2] + t * (poses[n + 2] - poses[o + 2]));
        group.quaternion.copy(this.a);
      }
    }
  }
}
