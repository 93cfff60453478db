// The turnable view of a body. Draws on demand: when a control moves, or the body is turned.
"use strict";
const T = globalThis.THREE;
const COLOUR = { tissue: 0xf3d9cd, anchored: 0x0072b2, free: 0xb9bec6, grasp: 0xe69f00, measured: 0x222222,
                 predicted: 0xd55e00, outline: 0x9aa0a6, edge: 0x6b5a52 };
const FIELD = 28, TURN = 0.008, NEAREST = 0.25, FARTHEST = 4;

function unpack(text, kind) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  return new kind(bytes.buffer);
}

// Three digits, as the rest of the report has them.
const digits = (value) => (Number.isFinite(value) ? String(Number(value.toPrecision(3))) : "none");

class Body {
  constructor(figure, data) {
    this.figure = figure;
    this.data = data;
    this.find = (name) => figure.querySelector("." + name);
    this.points = unpack(data.points, Float32Array);
    this.triangles = unpack(data.triangles, Uint32Array);
    this.place = unpack(data.place, Uint16Array);
    this.edges = unpack(data.edges, Uint32Array);
    this.moves = unpack(data.displacement.numbers, Uint16Array);
    this.measured = unpack(data.measured, Float32Array);
    this.models = data.models.map((model) => unpack(model.predicted, Float32Array));
    this.renderer = new T.WebGLRenderer({ canvas: this.find("canvas"), antialias: true });
    this.renderer.setPixelRatio(Math.min(globalThis.devicePixelRatio || 1, 2));
    this.scene = new T.Scene();
    this.scene.background = new T.Color(0xffffff);
    this.camera = new T.PerspectiveCamera(FIELD, 1, 0.1, 1e5);
    this.measure();
    this.build();
    this.listen();
    this.resize();
  }

  // Centre, size and the axes that the camera turns about.
  measure() {
    const box = new T.Box3().setFromArray(this.points);
    this.centre = box.getCenter(new T.Vector3());
    this.diagonal = box.getSize(new T.Vector3()).length() || 1;
    this.up = new T.Vector3(...this.data.up).normalize();
    if (!(this.up.length() > 0.5)) this.up.set(0, 1, 0);
    this.across = new T.Vector3().crossVectors(this.up, new T.Vector3(1, 0, 0));
    if (this.across.length() < 0.1) this.across.crossVectors(this.up, new T.Vector3(0, 1, 0));
    this.across.normalize();
    this.ahead = new T.Vector3().crossVectors(this.across, this.up);
    this.home();
  }

  home() {
    this.azimuth = -Math.PI / 4;
    this.elevation = 0.7;
    this.zoom = 1;
  }

  build() {
    this.moved = new T.BufferAttribute(new Float32Array(this.points), 3);
    const light = new T.DirectionalLight(0xffffff, 1.5);
    light.position.set(-0.4, 0.7, 1);
    this.camera.add(light);
    this.scene.add(this.camera, new T.HemisphereLight(0xffffff, 0xd8d4d0, 2.1));
    this.parts = this.data.places.map((place, number) => this.surface(place, number)).filter(Boolean);
    this.scene.add(this.lines(new T.BufferAttribute(this.points, 3), COLOUR.outline));
    this.scene.add(this.lines(this.moved, COLOUR.edge));
    const count = this.data.fiducials.length, size = this.diagonal / 130;
    this.seen = this.many(new T.SphereGeometry(size, 16, 12), COLOUR.measured, count);
    this.expected = this.many(new T.OctahedronGeometry(1.5 * size), COLOUR.predicted, count);
    this.shafts = this.many(new T.CylinderGeometry(0.45 * size, 0.45 * size, 1, 10).translate(0, 0.5, 0), COLOUR.predicted, count);
    this.tips = this.many(new T.ConeGeometry(1.3 * size, 3.2 * size, 14).translate(0, -1.6 * size, 0), COLOUR.predicted, count);
    this.tipLength = 3.2 * size;
  }

  surface(place, number) {
    const index = [];
    for (let t = 0; t < this.place.length; t++)
      if (this.place[t] === number) index.push(...this.triangles.subarray(3 * t, 3 * t + 3));
    if (!index.length) return null;
    const geometry = new T.BufferGeometry();
    geometry.setAttribute("position", this.moved);
    geometry.setIndex(index);
    const material = new T.MeshLambertMaterial({ side: T.DoubleSide, flatShading: true });
    const mesh = new T.Mesh(geometry, material);
    mesh.frustumCulled = false;
    this.scene.add(mesh);
    let label = null;
    if (place.kind === "patch") {
      label = document.createElement("span");
      this.find("labels").append(label);
    }
    return { place, mesh, index, label };
  }

  // Stripes on the screen, by which anchored patches are told without colours.
  hatch(material) {
    material.onBeforeCompile = (shader) => {
      shader.fragmentShader = shader.fragmentShader.replace("#include <dithering_fragment>",
        "#include <dithering_fragment>\n if (mod(gl_FragCoord.x + gl_FragCoord.y, 14.0) < 2.5) gl_FragColor.rgb = mix(gl_FragColor.rgb, vec3(1.0), 0.55);");
    };
    material.customProgramCacheKey = () => "hatched";
  }

  lines(position, colour) {
    const geometry = new T.BufferGeometry();
    geometry.setAttribute("position", position);
    geometry.setIndex(Array.from(this.edges));
    const lines = new T.LineSegments(geometry, new T.LineBasicMaterial({ color: colour }));
    lines.frustumCulled = false;
    return lines;
  }

  many(geometry, colour, count) {
    const mesh = new T.InstancedMesh(geometry, new T.MeshLambertMaterial({ color: colour }), Math.max(count, 1));
    mesh.frustumCulled = false;
    // Markers inside the body show through it.
    mesh.renderOrder = 2;
    this.scene.add(mesh);
    return mesh;
  }

  listen() {
    const on = (name, event, act) => this.find(name)?.addEventListener(event, act);
    on("frame", "input", () => this.show());
    for (const name of ["scale", "model", "shown"]) on(name, "change", () => this.show());
    on("play", "click", () => this.play());
    on("nearer", "click", () => this.approach(1 / 1.25));
    on("farther", "click", () => this.approach(1.25));
    on("reset", "click", () => { this.home(); this.draw(); });
    const canvas = this.find("canvas");
    const fingers = new Map();
    canvas.addEventListener("pointerdown", (e) => { fingers.set(e.pointerId, e); canvas.setPointerCapture(e.pointerId); });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (e) => fingers.delete(e.pointerId));
    canvas.addEventListener("pointermove", (e) => this.drag(e, fingers));
    canvas.addEventListener("wheel", (e) => {
      if (!e.ctrlKey && !e.metaKey) return;
      e.preventDefault();
      this.approach(Math.exp(0.002 * e.deltaY));
    }, { passive: false });
    const keys = { ArrowLeft: [-12, 0], ArrowRight: [12, 0], ArrowUp: [0, -12], ArrowDown: [0, 12] };
    canvas.addEventListener("keydown", (e) => {
      if (e.key in keys) { e.preventDefault(); this.turn(...keys[e.key]); }
      if (e.key === "+") this.approach(1 / 1.25);
      if (e.key === "-") this.approach(1.25);
    });
    canvas.addEventListener("webglcontextlost", () => this.figure.classList.remove("live"));
    new ResizeObserver(() => this.resize()).observe(this.find("stage"));
  }

  drag(event, fingers) {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    if (fingers.size === 1) this.turn(event.clientX - before.clientX, event.clientY - before.clientY);
    else {
      const other = [...fingers.values()].find((finger) => finger.pointerId !== event.pointerId);
      const apart = (e) => Math.hypot(e.clientX - other.clientX, e.clientY - other.clientY) || 1;
      this.approach(apart(before) / apart(event));
    }
    fingers.set(event.pointerId, event);
  }

  turn(x, y) {
    this.azimuth -= TURN * x;
    this.elevation = Math.max(-1.5, Math.min(1.5, this.elevation + TURN * y));
    this.draw();
  }

  approach(factor) {
    this.zoom = Math.max(NEAREST, Math.min(FARTHEST, this.zoom * factor));
    this.draw();
  }

  play() {
    const slider = this.find("frame"), button = this.find("play");
    if (this.timer) {
      clearInterval(this.timer);
      this.timer = null;
    } else {
      if (+slider.value === +slider.max) slider.value = 0;
      this.timer = setInterval(() => {
        if (+slider.value >= +slider.max) this.play();
        else { slider.value = +slider.value + 1; this.show(); }
      }, 160);
    }
    button.textContent = this.timer ? "Pause" : "Play";
  }

  resize() {
    const stage = this.find("stage"), width = stage.clientWidth, height = stage.clientHeight;
    if (!width || !height) return;
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.show();
  }

  // Everything that depends on the frame or on a control.
  show() {
    this.deform(+this.find("frame").value);
    this.mark(+this.find("frame").value);
    this.colour();
    this.draw();
  }

  // Position of the nodes in a frame, between the frames that are kept.
  deform(frame) {
    const { frames, low, step } = this.data.displacement, count = this.points.length;
    let k = 0;
    while (k + 1 < frames.length && frames[k + 1] <= frame) k++;
    const next = Math.min(k + 1, frames.length - 1);
    const share = next === k ? 0 : (frame - frames[k]) / (frames[next] - frames[k]);
    const moved = this.moved.array;
    for (let i = 0; i < count; i++) {
      const number = this.moves[k * count + i] * (1 - share) + this.moves[next * count + i] * share;
      moved[i] = this.points[i] + low[i % 3] + step[i % 3] * number;
    }
    this.moved.needsUpdate = true;
  }

  // Markers, arrows and numbers of a frame.
  mark(frame) {
    const { data } = this, count = data.fiducials.length;
    const predicted = this.models[+(this.find("model")?.value ?? 0)], scale = +this.find("scale").value;
    const nothing = new T.Matrix4().makeScale(0, 0, 0), one = new T.Vector3(1, 1, 1);
    let sum = 0, numbers = 0, worst = -1, farthest = 0, seen = 0;
    for (let i = 0; i < count; i++) {
      const at = 3 * (frame * count + i);
      const m = new T.Vector3(...this.measured.subarray(at, at + 3)), p = new T.Vector3(...predicted.subarray(at, at + 3));
      const residual = m.clone().sub(p), length = residual.length();
      this.seen.setMatrixAt(i, Number.isFinite(m.x + m.y + m.z) ? new T.Matrix4().setPosition(m) : nothing);
      this.expected.setMatrixAt(i, Number.isFinite(p.x + p.y + p.z) ? new T.Matrix4().setPosition(p) : nothing);
      for (const part of [residual.x, residual.y, residual.z]) if (Number.isFinite(part)) { sum += part * part; numbers++; }
      let shaft = nothing, tip = nothing;
      if (Number.isFinite(length)) {
        seen++;
        if (length > farthest) { farthest = length; worst = i; }
        const drawn = scale * length;
        if (drawn > 0.3 * this.tipLength) {
          const turn = new T.Quaternion().setFromUnitVectors(new T.Vector3(0, 1, 0), residual.clone().normalize());
          const small = Math.min(1, drawn / (1.5 * this.tipLength));
          shaft = new T.Matrix4().compose(p, turn, new T.Vector3(small, Math.max(drawn - small * this.tipLength, 1e-6), small));
          tip = new T.Matrix4().compose(p.clone().addScaledVector(residual, scale), turn, one.clone().multiplyScalar(small));
        }
      }
      this.shafts.setMatrixAt(i, shaft);
      this.tips.setMatrixAt(i, tip);
    }
    for (const mesh of [this.seen, this.expected, this.shafts, this.tips]) mesh.instanceMatrix.needsUpdate = true;
    const grasp = data.grasps[frame] ? `, grasp ${data.grasps[frame]}` : "";
    const label = `action ${data.actions[frame]}, step ${data.steps[frame]}${grasp}`;
    this.find("where").textContent = label;
    this.find("frame").setAttribute("aria-valuetext", label);
    this.find("rms").textContent = `${digits(Math.sqrt(sum / numbers) * data.factor)} ${data.unit}`;
    this.find("worst").textContent = worst < 0 ? "none is seen" : `${digits(farthest * data.factor)} ${data.unit} at fiducial ${data.fiducials[worst]}`;
    this.find("count").textContent = `${seen} of ${count}`;
    this.figure.dataset.frame = frame;
  }

  // Colours of the places, by what is asked for.
  colour() {
    const chances = this.find("shown")?.value === "chance", grasp = this.data.grasps[+this.find("frame").value];
    this.figure.classList.toggle("chances", chances);
    for (const { place, mesh, label } of this.parts) {
      const held = place.kind === "patch" && place.anchored, gripped = place.kind === "grasp" && place.name === grasp;
      const shaded = chances && place.kind === "patch" && place.shade;
      const colour = shaded ? place.shade : held ? COLOUR.anchored : gripped ? COLOUR.grasp
        : place.kind === "patch" ? COLOUR.free : COLOUR.tissue;
      const solid = held || gripped || shaded;
      if (mesh.userData.hatched !== (held && !chances)) {
        mesh.material.dispose();
        mesh.material = new T.MeshLambertMaterial({ side: T.DoubleSide, flatShading: true });
        if (held && !chances) this.hatch(mesh.material);
        mesh.userData.hatched = held && !chances;
      }
      mesh.material.color.set(colour);
      mesh.material.opacity = solid ? 1 : 0.5;
      mesh.material.transparent = !solid;
      mesh.material.depthWrite = Boolean(solid);
      mesh.renderOrder = solid ? 0 : 1;
      if (label) {
        label.textContent = chances && place.chance ? `${place.name}: ${place.chance}` : place.name;
        label.classList.toggle("held", held);
      }
    }
  }

  aim() {
    const away = new T.Vector3()
      .addScaledVector(this.ahead, Math.cos(this.elevation) * Math.cos(this.azimuth))
      .addScaledVector(this.across, Math.cos(this.elevation) * Math.sin(this.azimuth))
      .addScaledVector(this.up, Math.sin(this.elevation));
    const tangent = Math.tan((FIELD * Math.PI) / 360), aspect = this.camera.aspect;
    const right = new T.Vector3().crossVectors(this.up, away).normalize(), high = new T.Vector3().crossVectors(away, right);
    // As near as the whole body fits, at rest and as it is. The nearer half looks larger: a few turns find middle and distance.
    const seen = [], at = new T.Vector3();
    for (const points of [this.points, this.moved.array])
      for (let i = 0; i < points.length; i += 3) {
        at.set(points[i], points[i + 1], points[i + 2]).sub(this.centre);
        seen.push([at.dot(right), at.dot(high), at.dot(away)]);
      }
    let distance = 2 * this.diagonal;
    const middle = [0, 0], half = [tangent * aspect, tangent];
    for (let turn = 0; turn < 6; turn++) {
      let next = 0;
      for (const k of [0, 1]) {
        let low = Infinity, most = -Infinity;
        for (const point of seen) {
          const slope = (point[k] - middle[k]) / (distance - point[2]);
          low = Math.min(low, slope);
          most = Math.max(most, slope);
        }
        middle[k] += ((low + most) / 2) * distance;
        for (const point of seen) next = Math.max(next, point[2] + Math.abs(point[k] - middle[k]) / half[k]);
      }
      distance = Math.max(next, 0.6 * this.diagonal);
    }
    distance *= 1.08 * this.zoom;
    const target = this.centre.clone().addScaledVector(right, middle[0]).addScaledVector(high, middle[1]);
    this.camera.position.copy(target).addScaledVector(away, distance);
    this.camera.up.copy(this.up);
    this.camera.lookAt(target);
    this.camera.near = Math.max(distance - 3 * this.diagonal, 0.01 * this.diagonal);
    this.camera.far = distance + 3 * this.diagonal;
    this.camera.updateProjectionMatrix();
  }

  draw() {
    this.aim();
    this.camera.updateMatrixWorld();
    this.renderer.render(this.scene, this.camera);
    const stage = this.find("stage");
    for (const part of this.parts) {
      if (!part.label) continue;
      const middle = new T.Vector3(), unique = part.index;
      for (const node of unique) middle.add(new T.Vector3().fromArray(this.moved.array, 3 * node));
      middle.divideScalar(unique.length);
      const outward = middle.clone().sub(this.centre);
      middle.addScaledVector(outward.normalize(), 0.045 * this.diagonal).project(this.camera);
      const x = ((middle.x + 1) / 2) * stage.clientWidth, y = ((1 - middle.y) / 2) * stage.clientHeight;
      part.label.style.transform = `translate(-50%, -50%) translate(${x.toFixed(1)}px, ${y.toFixed(1)}px)`;
    }
  }
}

function begin(figure) {
  const data = JSON.parse(document.getElementById(figure.dataset.view).textContent);
  figure.classList.add("live");
  try {
    figure.body = new Body(figure, data);
  } catch (error) {
    console.warn(`the body cannot be drawn: ${error.message}`);
    // Without WebGL the picture stays.
    figure.classList.remove("live");
  }
}

// A page may hold more bodies than a browser draws at once: each is made when it comes into sight.
const watch = new IntersectionObserver((entries) => {
  for (const entry of entries) {
    if (!entry.isIntersecting) continue;
    watch.unobserve(entry.target);
    begin(entry.target);
  }
}, { rootMargin: "200px" });
for (const figure of document.querySelectorAll("figure[data-view]")) watch.observe(figure);
