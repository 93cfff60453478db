// The turnable view of a body. Draws on demand: when a control moves, or the body is turned.
"use strict";
const T = globalThis.THREE;
const COLOUR = { tissue: 0xf3d9cd, anchored: 0x0072b2, free: 0xb9bec6, grasp: 0xe69f00, held: 0x4d5661, driven: 0x7b5ea7, measured: 0x222222,
                 predicted: 0xd55e00, outline: 0x9aa0a6, edge: 0x6b5a52 };
const TURN = 0.008, NEAREST = 0.25, FARTHEST = 4;
// What the surface may be coloured by, node by node.
const FIELDS = { displacement: "mm", energy: "J/m³", residual: "mm" };

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
    // Parallel: a length is the same everywhere in the picture.
    this.camera = new T.OrthographicCamera(-1, 1, 1, -1, 0.1, 1e5);
    this.measure();
    this.fields();
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

  // The largest value of each field over all frames, by which its colours are told apart.
  fields() {
    const { frames, low, step } = this.data.displacement, count = this.points.length;
    let longest = 0;
    for (let k = 0; k < frames.length; k++)
      for (let i = 0; i < count; i += 3) {
        let square = 0;
        for (let a = 0; a < 3; a++) square += (low[a] + step[a] * this.moves[k * count + i + a]) ** 2;
        longest = Math.max(longest, square);
      }
    this.most = { displacement: Math.sqrt(longest), energy: this.data.energy?.most ?? 0 };
    this.energy = this.data.energy ? unpack(this.data.energy.numbers, Uint8Array) : null;
    this.values = new Float32Array(count / 3);
    this.shades = this.data.shades.map((text) => new T.Color(text));
  }

  home() {
    this.azimuth = -Math.PI / 4;
    this.elevation = 0.7;
    this.zoom = 1;
  }

  build() {
    this.moved = new T.BufferAttribute(new Float32Array(this.points), 3);
    this.shade = new T.BufferAttribute(new Float32Array(this.points.length), 3);
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
    geometry.setAttribute("color", this.shade);
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
    this.aspect = width / height;
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
    const { low, step } = this.data.displacement, count = this.points.length;
    const { k, next, share } = this.between(frame);
    const moved = this.moved.array;
    for (let i = 0; i < count; i++) {
      const number = this.moves[k * count + i] * (1 - share) + this.moves[next * count + i] * share;
      moved[i] = this.points[i] + low[i % 3] + step[i % 3] * number;
    }
    this.moved.needsUpdate = true;
  }

  // Between which of the frames that are kept a frame lies, and how far.
  between(frame) {
    const { frames } = this.data.displacement;
    let k = 0;
    while (k + 1 < frames.length && frames[k + 1] <= frame) k++;
    const next = Math.min(k + 1, frames.length - 1);
    return { k, next, share: next === k ? 0 : (frame - frames[k]) / (frames[next] - frames[k]) };
  }

  // Values of a field at the nodes in a frame; the largest of all frames.
  field(name, frame) {
    const count = this.values.length, moved = this.moved.array;
    if (name === "displacement")
      for (let i = 0; i < count; i++)
        this.values[i] = Math.hypot(...[0, 1, 2].map((a) => moved[3 * i + a] - this.points[3 * i + a]));
    if (name === "energy") {
      const { k, next, share } = this.between(frame);
      for (let i = 0; i < count; i++)
        this.values[i] = ((this.energy[k * count + i] * (1 - share) + this.energy[next * count + i] * share) / 255) * this.most.energy;
    }
    if (name === "residual") return this.residual(frame);
    return this.most[name];
  }

  // The residual at the markers, spread over the surface with weights that fall with the fourth power of the distance.
  residual(frame) {
    const { data } = this, fiducials = data.fiducials.length, known = [], predicted = this.model();
    const length = (at) => Math.hypot(...[0, 1, 2].map((a) => this.measured[at + a] - predicted[at + a]));
    let most = 0;
    for (let i = 0; i < this.measured.length; i += 3) most = Math.max(most, length(i) || 0);
    for (let f = 0; f < fiducials; f++) {
      const at = 3 * (frame * fiducials + f), size = length(at);
      if (Number.isFinite(size)) known.push([predicted[at], predicted[at + 1], predicted[at + 2], size]);
    }
    const moved = this.moved.array;
    for (let i = 0; i < this.values.length; i++) {
      let sum = 0, weights = 1e-12;
      for (const [x, y, z, size] of known) {
        const square = (moved[3 * i] - x) ** 2 + (moved[3 * i + 1] - y) ** 2 + (moved[3 * i + 2] - z) ** 2 + 1e-6;
        sum += size / square ** 2;
        weights += 1 / square ** 2;
      }
      this.values[i] = sum / weights;
    }
    return most;
  }

  // Colours of the nodes by a field, and what they mean.
  paint(name, frame) {
    const most = this.field(name, frame) || 1, last = this.shades.length - 1, shade = this.shade.array;
    for (let i = 0; i < this.values.length; i++) {
      const at = Math.min(Math.max((this.values[i] / most) * last, 0), last), k = Math.min(Math.floor(at), last - 1);
      const one = this.shades[k], two = this.shades[k + 1], part = at - k;
      shade[3 * i] = one.r + part * (two.r - one.r);
      shade[3 * i + 1] = one.g + part * (two.g - one.g);
      shade[3 * i + 2] = one.b + part * (two.b - one.b);
    }
    this.shade.needsUpdate = true;
    return most;
  }

  model() {
    return this.models[+(this.find("model")?.value ?? 0)];
  }

  // Markers, arrows and numbers of a frame.
  mark(frame) {
    const { data } = this, count = data.fiducials.length;
    const predicted = this.model(), scale = +this.find("scale").value;
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
    this.find("rms").textContent = `${digits(Math.sqrt(sum / numbers))} mm`;
    this.find("worst").textContent = worst < 0 ? "none is seen" : `${digits(farthest)} mm at fiducial ${data.fiducials[worst]}`;
    this.find("count").textContent = `${seen} of ${count}`;
    this.figure.dataset.frame = frame;
  }

  // Colours of the places, by what is asked for.
  colour() {
    const frame = +this.find("frame").value, shown = this.find("shown").value, grasp = this.data.grasps[frame];
    const chances = shown === "chance", field = shown in FIELDS;
    this.figure.classList.toggle("shaded", chances || field);
    if (chances || field) {
      const most = field ? this.paint(shown, frame) : 1, unit = FIELDS[shown] ?? "";
      this.find("shade-name").textContent = `${this.find("shown").selectedOptions[0].textContent} 0`;
      this.find("shade-most").textContent = `${digits(most)} ${unit}`;
    }
    for (const { place, mesh, label } of this.parts) {
      const held = place.kind === "patch" && place.anchored, gripped = place.kind === "grasp" && place.name === grasp;
      const shaded = chances && place.kind === "patch" && place.shade;
      const colour = shaded ? place.shade : held ? COLOUR.anchored : gripped ? COLOUR.grasp
        : place.kind === "patch" ? COLOUR.free : place.kind in { held: 1, driven: 1 } ? COLOUR[place.kind] : COLOUR.tissue;
      const solid = held || gripped || place.kind === "held" || shaded || field, kind = `${field}${Boolean(solid)}${held && !chances}`;
      if (mesh.userData.kind !== kind) {
        mesh.material.dispose();
        // Light would change what a colour means, and show triangles of the far side as shards through what is transparent.
        mesh.material = field || !solid ? new T.MeshBasicMaterial({ side: T.DoubleSide, vertexColors: field })
          : new T.MeshLambertMaterial({ side: T.DoubleSide, flatShading: true });
        if (held && !chances) this.hatch(mesh.material);
        mesh.userData.kind = kind;
      }
      mesh.userData.solid = Boolean(solid);
      mesh.material.color.set(field ? 0xffffff : colour);
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
    const aspect = this.aspect, at = new T.Vector3();
    this.right = new T.Vector3().crossVectors(this.up, away).normalize();
    this.high = new T.Vector3().crossVectors(away, this.right);
    this.away = away;
    // As large as the whole body fits, at rest and as it is.
    const low = [Infinity, Infinity], most = [-Infinity, -Infinity];
    for (const points of [this.points, this.moved.array])
      for (let i = 0; i < points.length; i += 3) {
        at.set(points[i], points[i + 1], points[i + 2]).sub(this.centre);
        [at.dot(this.right), at.dot(this.high)].forEach((value, k) => {
          low[k] = Math.min(low[k], value);
          most[k] = Math.max(most[k], value);
        });
      }
    const half = 0.5 * 1.1 * this.zoom * Math.max(most[1] - low[1], (most[0] - low[0]) / aspect, 0.3 * this.diagonal);
    const target = this.centre.clone().addScaledVector(this.right, (low[0] + most[0]) / 2).addScaledVector(this.high, (low[1] + most[1]) / 2);
    Object.assign(this.camera, { left: -half * aspect, right: half * aspect, top: half, bottom: -half });
    this.camera.position.copy(target).addScaledVector(away, 3 * this.diagonal);
    this.camera.up.copy(this.up);
    this.camera.lookAt(target);
    this.camera.near = 0.01 * this.diagonal;
    this.camera.far = 6 * this.diagonal;
    this.camera.updateProjectionMatrix();
    this.scale = this.find("stage").clientHeight / (2 * half);
  }

  draw() {
    this.aim();
    this.camera.updateMatrixWorld();
    this.renderer.render(this.scene, this.camera);
    this.name();
    this.key();
  }

  // Names of the patches, on them, where nothing solid is in front.
  name() {
    const stage = this.find("stage"), ray = new T.Raycaster(), far = 3 * this.diagonal;
    for (const part of this.parts) {
      if (!part.label) continue;
      const middle = new T.Vector3();
      for (const node of part.index) middle.add(new T.Vector3().fromArray(this.moved.array, 3 * node));
      middle.divideScalar(part.index.length);
      ray.set(middle.clone().addScaledVector(this.away, far), this.away.clone().negate());
      ray.far = far - 0.02 * this.diagonal;
      const front = this.parts.filter((other) => other !== part && other.mesh.userData.solid).map((other) => other.mesh);
      for (const mesh of front) mesh.geometry.boundingSphere = null;
      part.label.hidden = ray.intersectObjects(front, false).length > 0;
      middle.project(this.camera);
      const x = ((middle.x + 1) / 2) * stage.clientWidth, y = ((1 - middle.y) / 2) * stage.clientHeight;
      part.label.style.transform = `translate(-50%, -50%) translate(${x.toFixed(1)}px, ${y.toFixed(1)}px)`;
    }
  }

  // Axes, the direction of gravity and a scale bar.
  key() {
    const flat = (way) => [way.dot(this.right), -way.dot(this.high)];
    const ways = { x: new T.Vector3(1, 0, 0), y: new T.Vector3(0, 1, 0), z: new T.Vector3(0, 0, 1), g: this.up.clone().negate() };
    for (const [name, way] of Object.entries(ways)) {
      const [x, y] = flat(way), from = name === "g" ? [112, 30] : [50, 50], long = name === "g" ? 34 : 28;
      const arrow = this.find(`axis-${name} path`), text = this.find(`axis-${name} text`), reach = name === "g" ? -12 : long + 13;
      const at = (along, aside) => `${(from[0] + along * x - aside * y).toFixed(1)} ${(from[1] + along * y + aside * x).toFixed(1)}`;
      const flatness = Math.hypot(x, y), head = Math.min(9 / Math.max(flatness, 0.1), long);
      const wide = 4.5 / Math.max(flatness, 0.1);
      arrow.setAttribute("d", `M${at(0, 0)} L${at(long - head, 0)} M${at(long, 0)} L${at(long - head, wide)} L${at(long - head, -wide)}Z`);
      text.setAttribute("x", (from[0] + reach * x).toFixed(1));
      text.setAttribute("y", (from[1] + reach * y + 4.5).toFixed(1));
    }
    const wanted = Math.min(140, 0.25 * this.find("stage").clientWidth) / this.scale, power = 10 ** Math.floor(Math.log10(wanted));
    const length = power * [5, 2, 1].find((step) => step * power <= wanted);
    this.find("bar").style.width = `${(length * this.scale).toFixed(1)}px`;
    this.find("bar-text").textContent = `${Number(length.toPrecision(1))} mm`;
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
