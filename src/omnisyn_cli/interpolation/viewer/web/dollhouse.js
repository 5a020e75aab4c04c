// The tour from outside: a coarse mesh of every panorama with its smallest picture. Only what faces the eye is drawn, so
// that walls and ceilings are open towards it.

const GRAZING = 0.12; // cosine to the ray that a triangle was seen on, below which it is stretched
const MOST_TRIANGLES = 150_000; // of all panoramas: tours of more than eight get coarser ones
const PICTURE_BYTES = 48 * MEGABYTE; // of graphics memory, for the pictures of all panoramas
const FLIGHT = 0.9; // seconds
const TILT = { least: -Math.PI / 2, usual: -0.9, most: -0.15 }; // radians; from straight above to nearly level

// An eye that goes around a tour. It has what Controls move, as a Walker has.
class Orbit {
  constructor(world) {
    const places = world.panoramas.map(({ position, eyeHeight }) => minus(position, [0, eyeHeight, 0]));
    const [low, high] = [Math.min, Math.max].map((most) => [0, 1, 2].map((axis) => most(...places.map((at) => at[axis]))));
    this.size = Math.max(length(minus(high, low)), 2) + 6;
    Object.assign(this, { focus: mixed(low, high, 0.5), yaw: 0, pitch: TILT.usual, fov: 0.8, distance: 1.1 * this.size, isFlat: false, flight: null });
  }

  get attitude() {
    return null;
  }

  get speed() {
    return this.distance / 3;
  }

  get reach() {
    return 2 * Math.tan(this.fov / 2) * this.distance;
  }

  get pose() {
    const { yaw, fov, isFlat } = this, pitch = isFlat ? TILT.least : this.pitch;
    return { position: minus(this.focus, times(rotated(rotationOfLook(yaw, pitch), [0, 0, -1]), this.distance)), yaw, pitch, fov };
  }

  turn(right, up) {
    this.yaw -= 2 * right;
    this.pitch = clamp(this.pitch - 2 * up, TILT.least, TILT.most);
  }

  zoom(factor) {
    this.distance = clamp(this.distance * factor, 1.5, 4 * this.size);
  }

  walk(metres) {
    this.zoom(Math.exp(-metres));
  }

  // Across the floor: what leads up goes away from the eye.
  step(right, up, ahead) {
    const [s, c, far] = [Math.sin(this.yaw), Math.cos(this.yaw), up + ahead];
    this.focus = add(this.focus, [right * c + far * s, 0, right * s - far * c]);
  }

  stop() {}

  // From one pose to another, which may move meanwhile; `then` is called at its end.
  fly(from, to, seconds, then) {
    this.flight = { from, to, seconds: Math.max(seconds, 1e-3), then, passed: 0 };
  }

  advance(seconds) {
    const { flight } = this;
    if (!flight) return false;
    flight.passed += seconds || 1 / 60;
    if (flight.passed >= flight.seconds) {
      this.flight = null;
      flight.then();
    }
    return true;
  }

  get shown() {
    const { flight } = this;
    if (!flight) return this.pose;
    const x = flight.passed / flight.seconds, share = x * x * (3 - 2 * x), from = flight.from(), to = flight.to();
    const turn = (to.yaw - from.yaw) % (2 * Math.PI), shortest = turn - 2 * Math.PI * Math.round(turn / (2 * Math.PI));
    const [pitch, fov] = ['pitch', 'fov'].map((key) => from[key] + share * (to[key] - from[key]));
    return { position: mixed(from.position, to.position, share), yaw: from.yaw + share * shortest, pitch, fov };
  }
}

class Dollhouse {
  // Pins lead to panoramas; `onChange` asks for another picture.
  constructor(root, host, world, onGo, onChange) {
    Object.assign(this, { host, world, onChange, isOpen: false, meshes: [], orbit: null });
    for (const id of ['outside', 'flat', 'stage']) this[id] = root.getElementById(id);
    this.pins = world.panoramas.map(({ index, title }) => {
      const pin = document.createElement('button');
      pin.className = 'pin';
      pin.title = title;
      pin.setAttribute('aria-label', `Fly into ${title}`);
      pin.addEventListener('click', () => onGo(index));
      return pin;
    });
    root.getElementById('pins').append(...this.pins);
  }

  // Flies out of the place where the walker stands; pictures appear as they come.
  open(renderer, walker, isStill) {
    this.renderer = renderer;
    this.program ??= renderer.program(OUTSIDE_VERTEX, OUTSIDE_FRAGMENT);
    this.orbit ??= new Orbit(this.world);
    this.orbit.yaw = walker.yaw;
    this.mark(true);
    this.orbit.fly(() => poseOf(walker), () => this.orbit.pose, isStill ? 0 : FLIGHT, () => {});
    this.loading = this.load();
    return this.loading;
  }

  // Flies to where the walker stands by now.
  close(walker, isStill, then) {
    const { shown } = this.orbit;
    this.flatten(false);
    this.orbit.fly(() => shown, () => poseOf(walker), isStill ? 0 : FLIGHT, () => {
      this.end();
      then();
    });
  }

  end() {
    for (const { vertices, buffers, photo } of this.meshes.splice(0)) {
      const { gl } = this.renderer;
      gl.deleteVertexArray(vertices);
      buffers.forEach((one) => gl.deleteBuffer(one));
      gl.deleteTexture(photo);
    }
    this.mark(false);
    this.flatten(false);
  }

  // After a context was lost nothing of it is left to be deleted.
  forgetGraphics() {
    this.meshes = [];
    this.program = null;
    this.mark(false);
    this.flatten(false);
  }

  mark(isOpen) {
    this.isOpen = isOpen;
    this.host.toggleAttribute('data-outside', isOpen);
    this.outside.setAttribute('aria-pressed', isOpen);
  }

  flatten(isFlat) {
    if (!this.orbit) return;
    this.orbit.isFlat = isFlat;
    this.flat.setAttribute('aria-pressed', isFlat);
  }

  async load() {
    const { panoramas, walk, blocks } = this.world, { inverseDepth: map, peak } = walk.dollhouse;
    const depths = inverseDepths(await blocks.map(map), peak), rows = map.rows / panoramas.length;
    const width = Math.floor(Math.sqrt(PICTURE_BYTES / panoramas.length / (2 * MIP_SHARE)));
    await Promise.all(panoramas.map(async (panorama) => {
      const bitmap = await blocks.picture(panorama.photo[0]);
      const grid = depths.subarray(panorama.index * rows * map.cols, (panorama.index + 1) * rows * map.cols);
      const picture = bitmap.width > width ? shrunk(bitmap, width) : bitmap;
      if (this.isOpen) this.meshes.push({ ...this.mesh(outsideOf(panorama, grid, rows, map.cols, panoramas.length)), photo: this.photo(picture), bytes: 2 * MIP_SHARE * picture.width ** 2 });
      bitmap.close();
      this.onChange();
    }));
  }

  photo(picture) {
    const { gl } = this.renderer, made = photoTexture(gl, picture);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_NEAREST); // half the work in software
    return made;
  }

  mesh({ points, indices }) {
    const { gl } = this.renderer, vertices = gl.createVertexArray();
    const buffers = [buffer(gl, gl.ARRAY_BUFFER, points), buffer(gl, gl.ELEMENT_ARRAY_BUFFER, indices)];
    gl.bindVertexArray(vertices);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffers[0]);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers[1]);
    [[0, 3, 0], [1, 2, 12]].forEach(([at, count, offset]) => {
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, count, gl.FLOAT, false, 20, offset);
    });
    gl.bindVertexArray(null);
    return { vertices, buffers, count: indices.length };
  }

  get triangles() {
    return this.meshes.reduce((sum, { count }) => sum + count / 3, 0);
  }

  get bytes() {
    return this.meshes.reduce((sum, { bytes, count }) => sum + bytes + 20 * count, 0);
  }

  draw(size) {
    const { gl } = this.renderer, { shown, isFlat, distance, flight } = this.orbit;
    const rotation = rotationOfLook(shown.yaw, shown.pitch), flatAt = isFlat && !flight ? distance : 0;
    gl.viewport(0, 0, ...size);
    this.renderer.beginSurfaces(null, [0.07, 0.07, 0.08, 1]);
    this.program.use({ rotation, position: times(unrotated(rotation, shown.position), -1), lens: lensOf(shown.fov, size), flatAt });
    for (const { vertices, photo, count } of this.meshes) {
      this.program.set('photo', photo);
      gl.bindVertexArray(vertices);
      gl.drawElements(gl.TRIANGLES, count, gl.UNSIGNED_INT, 0);
    }
    gl.bindVertexArray(null);
    this.renderer.endSurfaces();
  }

  // Pins stand where panoramas were taken; there are none in flight.
  show([width, height]) {
    const { shown, flight, isFlat, distance } = this.orbit, lens = lensOf(shown.fov, [width, height]);
    this.world.panoramas.forEach(({ position }, index) => {
      const [x, y, z] = unrotated(rotationOfLook(shown.yaw, shown.pitch), minus(position, shown.position));
      const at = [lens[0] * x, lens[1] * y].map((slope) => slope / (isFlat ? distance : -z));
      const pin = this.pins[index];
      pin.hidden = Boolean(flight) || z >= 0 || Math.abs(at[0]) > 1 || Math.abs(at[1]) > 1;
      pin.style.transform = `translate(${(at[0] + 1) * width / 2}px, ${(1 - at[1]) * height / 2}px)`;
    });
  }
}

const poseOf = ({ position, yaw, pitch, fov }) => ({ position, yaw, pitch, fov });

// Points (place in the world and in the picture) and triangles of a panorama's grid of inverse depths: those that are
// neither hidden nor stretched.
function outsideOf({ position, rotation }, depths, rows, cols, count) {
  const step = Math.max(1, Math.sqrt(2 * rows * cols * 0.7 * count / MOST_TRIANGLES));
  const [down, across] = [Math.floor(rows / step), Math.floor(cols / step)];
  const points = new Float32Array(5 * down * (across + 1)), rays = new Float32Array(3 * down * (across + 1));
  const isThere = new Uint8Array(down * (across + 1)), indices = [];
  for (let k = 0; k < isThere.length; k++) {
    const [row, lap] = [Math.floor((Math.floor(k / (across + 1)) + 0.5) * rows / down), k % (across + 1)];
    const col = Math.floor((lap % across + 0.5) * cols / across), polar = (row + 0.5) * Math.PI / rows;
    const rho = depths[row * cols + col], around = azimuth(col, cols);
    isThere[k] = rho > 0 ? 1 : 0;
    const ray = rotated(rotation, [Math.sin(polar) * Math.sin(around), Math.cos(polar), -Math.sin(polar) * Math.cos(around)]);
    rays.set(ray, 3 * k);
    points.set([...add(position, times(ray, 1 / Math.max(rho, 1e-6))), (col + 0.5) / cols + (lap === across ? 1 : 0), (row + 0.5) / rows], 5 * k);
  }
  const place = (k) => points.subarray(5 * k, 5 * k + 3);
  const isShown = (a, b, c) => {
    if (!(isThere[a] && isThere[b] && isThere[c])) return false;
    const [u, v] = [minus(place(b), place(a)), minus(place(c), place(a))];
    const normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    return Math.abs(dot(normal, rays.subarray(3 * a, 3 * a + 3))) > GRAZING * length(normal);
  };
  for (let row = 0; row < down - 1; row++) {
    for (let col = 0; col < across; col++) {
      const a = row * (across + 1) + col, b = a + 1, c = a + across + 1, d = c + 1;
      if (isShown(a, d, c)) indices.push(a, d, c);
      if (isShown(a, b, d)) indices.push(a, b, d);
    }
  }
  return { points, indices: new Uint32Array(indices) };
}
