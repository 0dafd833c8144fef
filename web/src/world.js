// One episode as a three.js scene.

import {
  AmbientLight, Box3, BoxGeometry, BufferAttribute, BufferGeometry, CapsuleGeometry, Color, CylinderGeometry, DirectionalLight,
  ConeGeometry, Group, HemisphereLight, Line, LineBasicMaterial, Mesh, MeshStandardMaterial, MeshBasicMaterial, Quaternion,
  Scene, SphereGeometry, SRGBColorSpace, Vector3,
} from "three";
import { locate } from "./unpack.js";

const UP = new Vector3(0, 1, 0);
/** Colours of contacts: robot and object, robot and surroundings, object and surroundings. */
const CONTACT = ["#0072b2", "#d55e00", "#7a7f87"];
const MAX_CONTACTS = 8;

function geometryOf(shape) {
  if (shape.box) return new BoxGeometry(...shape.box.map((half) => 2 * half));
  if (shape.sphere !== undefined) return new SphereGeometry(shape.sphere, 40, 24);
  if (shape.capsule) return new CapsuleGeometry(shape.capsule[0], 2 * shape.capsule[1], 12, 32).rotateX(Math.PI / 2);
  if (shape.cylinder) {
    const [radius, half] = shape.cylinder;
    return new CylinderGeometry(radius, radius, 2 * half, 48).rotateX(Math.PI / 2);
  }
  const flat = new BufferGeometry();
  flat.setAttribute("position", new BufferAttribute(Float32Array.from(shape.mesh.corners, (x) => x * 1e-4), 3));
  flat.setIndex(shape.mesh.faces);
  const sharp = flat.toNonIndexed();
  sharp.computeVertexNormals();
  return sharp;
}

/** A scene with the bodies of a clip, posed by `show`. */
export class World {
  constructor(clip, motion, solids, style) {
    this.clip = clip;
    this.motion = motion;
    this.scene = new Scene();
    this.bodies = Array.from({ length: clip.bodies }, () => new Group());
    this.scene.add(...this.bodies);
    const geometries = new Map();
    for (const at of clip.solids) {
      const solid = solids[at];
      const key = JSON.stringify(solid.shape);
      if (!geometries.has(key)) geometries.set(key, geometryOf(solid.shape));
      const material = new MeshStandardMaterial({
        color: new Color().setRGB(...solid.color.map((c) => c / 255), SRGBColorSpace), roughness: 0.62, metalness: 0.04,
      });
      if (solid.opacity !== undefined) {
        material.transparent = true;
        material.opacity = Math.max(0.15, solid.opacity);
      }
      const mesh = new Mesh(geometries.get(key), material);
      const [x, y, z, w, i, j, k] = solid.at;
      mesh.position.set(x, y, z);
      mesh.quaternion.set(i, j, k, w);
      mesh.castShadow = mesh.receiveShadow = true;
      this.bodies[solid.body]?.add(mesh);
    }
    this.light();
    this.arrows = Array.from({ length: MAX_CONTACTS }, () => this.arrow());
    this.showContacts = true;
    this.trail();
    this.restyle(style);
  }

  light() {
    this.scene.add(new HemisphereLight("#ffffff", "#8d8a84", 1.15), new AmbientLight("#ffffff", 0.25));
    const sun = new DirectionalLight("#fffaf2", 2.1);
    sun.position.set(0.1, -1.1, 2.2);
    sun.target.position.set(0.5, 0, 0);
    sun.castShadow = true;
    sun.shadow.mapSize.set(2048, 2048);
    const camera = sun.shadow.camera;
    [camera.left, camera.right, camera.bottom, camera.top, camera.near, camera.far] = [-1.2, 1.2, -1.2, 1.2, 0.3, 5];
    sun.shadow.bias = -0.0004;
    sun.shadow.normalBias = 0.006;
    this.scene.add(sun, sun.target);
  }

  arrow() {
    const group = new Group();
    const material = new MeshBasicMaterial({ depthTest: false, transparent: true, opacity: 0.95 });
    const shaft = new Mesh(new CylinderGeometry(0.0035, 0.0035, 1, 12).translate(0, 0.5, 0), material);
    const tip = new Mesh(new ConeGeometry(0.011, 0.026, 20).translate(0, 0.013, 0), material);
    const foot = new Mesh(new SphereGeometry(0.0085, 16, 12), material);
    group.add(shaft, tip, foot);
    group.renderOrder = 5;
    for (const part of group.children) part.renderOrder = 5;
    group.visible = false;
    this.scene.add(group);
    return { group, shaft, tip, material };
  }

  /** The path of the last body, which is the object in a scene of the built-in cell. */
  trail() {
    const body = this.motion.poses[this.clip.bodies - 1];
    if (!body || this.clip.frames < 2) return;
    const points = new Float32Array(3 * this.clip.frames);
    for (let i = 0; i < this.clip.frames; i++) for (let k = 0; k < 3; k++) points[3 * i + k] = body[k][i];
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(points, 3));
    this.path = new Line(geometry, new LineBasicMaterial({ transparent: true, opacity: 0.8 }));
    this.path.frustumCulled = false;
    this.scene.add(this.path);
  }

  restyle(style) {
    this.scene.background = new Color(style.background);
    if (this.path) this.path.material.color.set(style.accent);
  }

  /** Poses all bodies at a time; before the first frame and after the last one they stand still. */
  show(t) {
    const { times, poses, contacts } = this.motion;
    const [at, share] = locate(times, t);
    const next = Math.min(at + 1, times.length - 1);
    const q = new Quaternion(), p = new Quaternion();
    poses.forEach((c, body) => {
      const mix = (k) => c[k][at] + share * (c[k][next] - c[k][at]);
      this.bodies[body].position.set(mix(0), mix(1), mix(2));
      q.set(c[4][at], c[5][at], c[6][at], c[3][at]).normalize();
      p.set(c[4][next], c[5][next], c[6][next], c[3][next]).normalize();
      this.bodies[body].quaternion.copy(q.slerp(p, share));
    });
    if (this.path) this.path.geometry.setDrawRange(0, at + 1);
    const points = contacts[at] ?? [];
    this.arrows.forEach((arrow, i) => this.place(arrow, points[i]));
  }

  place({ group, shaft, tip, material }, point) {
    group.visible = this.showContacts && point !== undefined && (point.kind !== 2 || Math.hypot(...point.force) > 0.5);
    if (!group.visible) return;
    const force = new Vector3(...point.force);
    const newtons = force.length();
    // A logarithmic length keeps 1 N and 1,000 N readable.
    const length = Math.min(0.22, 0.035 * Math.log2(1 + newtons));
    material.color.set(CONTACT[point.kind] ?? CONTACT[2]);
    material.opacity = point.kind === 2 ? 0.45 : 0.95;
    group.position.set(...point.position);
    if (newtons > 0) group.quaternion.setFromUnitVectors(UP, force.normalize());
    shaft.scale.y = Math.max(1e-4, length);
    tip.position.y = length;
    tip.visible = length > 0.01;
  }

  /** The centre and the radius of the space that the moving bodies sweep. */
  bounds() {
    const moves = this.motion.poses.map((channels) => channels.some((values) => {
      let low = Infinity, high = -Infinity;
      for (const value of values) [low, high] = [Math.min(low, value), Math.max(high, value)];
      return high - low > 0.004;
    }));
    const box = new Box3(), centre = new Vector3();
    const every = Math.max(1, Math.floor(this.clip.frames / 24));
    for (let frame = 0; frame < this.clip.frames; frame += every) {
      this.show(this.motion.times[frame]);
      this.bodies.forEach((body, at) => {
        if (!moves[at]) return;
        body.updateMatrixWorld(true);
        for (const mesh of body.children) {
          mesh.geometry.boundingSphere ?? mesh.geometry.computeBoundingSphere();
          mesh.localToWorld(centre.copy(mesh.geometry.boundingSphere.center));
          const r = 0.6 * mesh.geometry.boundingSphere.radius;
          box.expandByPoint(centre.clone().addScalar(r));
          box.expandByPoint(centre.clone().addScalar(-r));
        }
      });
    }
    if (box.isEmpty()) return { centre: new Vector3(0.4, 0, 0.3), radius: 0.7 };
    const size = box.getSize(new Vector3());
    return { centre: box.getCenter(new Vector3()), radius: 0.5 * Math.max(0.2, size.length()) };
  }

  /** The position of the last body at a time. */
  object(t) {
    const body = this.motion.poses[this.clip.bodies - 1];
    if (!body) return [0.5, 0, 0.1];
    const [at] = locate(this.motion.times, t);
    return [body[0][at], body[1][at], body[2][at]];
  }

  dispose() {
    this.scene.traverse((node) => {
      node.geometry?.dispose();
      node.material?.dispose();
    });
  }
}
