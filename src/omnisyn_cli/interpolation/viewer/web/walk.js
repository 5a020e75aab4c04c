// A walk in an element of any page: what was packed is unpacked when it is needed, shown, and walked through.

const MOST_PIXELS = 2560 * 1440;
const SLOW = 40; // milliseconds of a frame above which pictures are made smaller while something moves
const FIRST_SHARE = 0.35; // of the sides of the first picture, which is small and comes at once
const FORMAT_VERSION = 1;
const PHONE_SIDE = 600; // pixels of the shorter side of a screen
const RETRY = 2000; // milliseconds until something that did not come is asked for again

// See docs/view.md. Options: `keys`, what keys are listened to on (the element itself); `keepsAddress`, whether the
// place is kept in the address of the page; `hasControls`, whether buttons, map and texts are shown; `budget`, bytes of
// graphics memory for panoramas; `isPhone`, smaller pictures and a smaller budget.
export class OmnisynWalk extends EventTarget {
  constructor(element, source, options = {}) {
    super();
    const isPhone = matchMedia('(pointer: coarse)').matches && Math.min(screen.width, screen.height) < PHONE_SIDE;
    this.options = { keys: null, keepsAddress: false, hasControls: true, isPhone, ...options };
    if (element.shadowRoot?.hasChildNodes()) throw new Error('expected an element of its own, got one with a shadow root; dispose of the walk in it');
    this.element = element;
    this.root = element.shadowRoot ?? element.attachShadow({ mode: 'open' }); // which stays after dispose
    this.root.innerHTML = MARKUP;
    const style = new CSSStyleSheet();
    style.replaceSync(STYLE);
    this.root.adoptedStyleSheets = [style];
    this.$ = (id) => this.root.getElementById(id);
    this.isStill = matchMedia('(prefers-reduced-motion: reduce)').matches;
    this.ending = new AbortController();
    Object.assign(this, { share: FIRST_SHARE, isWaiting: false, before: null, renderer: null, gl: null, arrivals: [] });
    element.dataset.state = 'loading';
    this.ready = this.begin(source).catch((error) => this.failed(error));
    this.ready.catch(() => {}); // said in the element, and told to those who wait for it
  }

  async begin(source) {
    const { signal } = this.ending;
    const { manifest, bytes } = await openedSource(source, signal);
    signal.throwIfAborted();
    if (manifest.version !== FORMAT_VERSION) throw new Error(`expected a walk of version ${FORMAT_VERSION}, got ${manifest.version}`);
    this.manifest = manifest;
    const blocks = new Blocks(bytes);
    blocks.fetchAhead(manifest.panoramas[manifest.start.panorama].photo[0].block); // while shaders are compiled
    this.openCanvas(this.$('view'));
    this.world = new World(manifest, blocks, this.gl, this.options);
    this.walker = new Walker(this.world);
    if (this.options.keepsAddress) this.walker.address = location.hash;
    this.wire();
    await this.prepare();
    signal.throwIfAborted();
    this.emit('ready');
  }

  openCanvas(canvas) {
    const gl = canvas.getContext('webgl2', { antialias: false, alpha: false, powerPreference: 'high-performance' });
    this.canvas = canvas;
    try {
      if (!gl) throw new Error('WebGL2 is not available');
      this.renderer = new Renderer(gl, this.manifest.tables);
      this.gl = gl;
    } catch (error) {
      this.useFade(error);
      return;
    }
    const { signal } = this.ending;
    canvas.addEventListener('webglcontextlost', (event) => {
      event.preventDefault();
      this.renderer = null;
      this.world.forgetGraphics();
      if (this.dollhouse?.isOpen) this.comeIn();
      this.dollhouse?.forgetGraphics();
      this.say('The picture was lost; waiting for it to come back …');
    }, { signal });
    canvas.addEventListener('webglcontextrestored', () => {
      this.renderer = new Renderer(gl, this.manifest.tables);
      this.say('');
      this.prepareAgain();
    }, { signal });
  }

  // A canvas that was asked for WebGL gives nothing else.
  useFade(error) {
    const fresh = this.canvas.cloneNode(false);
    this.canvas.replaceWith(fresh);
    this.canvas = fresh;
    this.fade = new FlatFade(fresh);
    this.say(`This browser cannot draw surfaces (${error.message}): the panoramas are cross-faded.`);
  }

  wire() {
    const { walker, world, $ } = this;
    const keys = this.options.keys ?? this.element, { signal } = this.ending;
    this.controls = new Controls($('stage'), keys, walker, () => this.change(), (x, y) => this.tap(x, y), signal);
    this.gyroscope = new Gyroscope(walker, () => this.change(), signal);
    for (const id of ['bar', 'where', 'welcome', 'stops']) $(id).hidden = !this.options.hasControls;
    $('place').max = world.isChain ? world.last : 1;
    $('place').addEventListener('input', (event) => {
      const value = Number(event.target.value);
      walker.stop();
      Object.assign(walker, world.isChain ? { s: value } : { t: value }, { beside: [0, 0, 0] });
      this.change();
    });
    $('play').addEventListener('click', () => this.togglePlay());
    $('whole').addEventListener('click', () => (document.fullscreenElement ? document.exitFullscreen() : this.element.requestFullscreen()));
    $('whole').hidden = !document.fullscreenEnabled;
    $('sensors').hidden = !Gyroscope.isThere;
    $('sensors').addEventListener('click', async () => $('sensors').setAttribute('aria-pressed', await this.gyroscope.toggle()));
    $('help').addEventListener('click', () => this.unfold('help', 'hint', $('hint').hidden));
    $('mapper').addEventListener('click', () => this.unfold('mapper', 'map', $('map').hidden));
    const headset = $('headset');
    Headset.isThere().then((isThere) => { headset.hidden = !(isThere && this.renderer); });
    headset.addEventListener('click', () => this.headset.enter(() => this.change(), () => this.keepUp(), signal));
    keys.addEventListener('keydown', (event) => this.key(event), { signal });
    document.addEventListener('fullscreenchange', () => {
      $('whole').setAttribute('aria-label', document.fullscreenElement ? 'Leave full screen' : 'Full screen');
    }, { signal });
    this.sides = new ResizeObserver(() => this.change());
    this.sides.observe(this.element);
    if (this.options.keepsAddress) window.addEventListener('hashchange', () => this.readAddress(), { signal });
    this.stops = world.panoramas.map((panorama) => this.makeStop(panorama));
    this.map = new TourMap(this.root, world, (index) => this.goTo(index));
    this.hotspots = new Hotspots(this.root, world, (spot) => this.emit('hotspot', spot));
    this.measure = new Measure(this.root, world, (x, y) => this.pointAt(x, y));
    $('measure').addEventListener('click', () => this.toggleMeasure());
    this.dollhouse = new Dollhouse(this.root, this.element, world, (index) => this.goTo(index), () => this.change());
    $('outside').addEventListener('click', () => this.toggleOutside());
    $('flat').addEventListener('click', () => this.flatten());
    if (this.fade) this.measure.forbid('as this browser has no WebGL2');
    else if (!this.manifest.isMetric) this.measure.forbid('as the unit of the poses is unknown: give --baseline or --camera-height, or scale them');
    $('outside').hidden = Boolean(this.fade) || !this.manifest.dollhouse;
    const hasMap = this.options.hasControls && (!world.isChain || this.manifest.plan) && this.element.clientWidth >= PHONE_SIDE;
    this.unfold('mapper', 'map', hasMap);
    this.hasTitles = world.panoramas.some(({ name, title, caption }) => caption || title !== name.replace(/\.[^.]*$/, ''));
    $('where').toggleAttribute('data-untitled', !this.hasTitles);
  }

  unfold(button, part, isShown) {
    this.$(part).hidden = !isShown;
    this.$(button).setAttribute('aria-expanded', isShown);
  }

  key(event) {
    if (event.key === 'Escape') this.escape();
    if (!isForWalk(event)) return;
    if (event.code === 'Space' && !(event.composedPath()[0] instanceof HTMLButtonElement)) {
      event.preventDefault();
      this.togglePlay();
    } else if (event.key === 'Home' || event.key === 'End') this.goTo(event.key === 'Home' ? 0 : this.world.last);
    else if (event.key === '?') this.$('help').click();
    else if (event.key === 'f') this.$('whole').click();
    else if (event.key === 'm') this.$('mapper').click();
    else if (event.key === 'r') this.toggleMeasure();
    else if (event.key === 'o') this.$('outside').click();
    else if (event.key === 't') this.flatten();
    else if (event.key === 'Enter' && this.measure.isOn && !(event.composedPath()[0] instanceof HTMLButtonElement)) this.pickAt(0.5, 0.5);
  }

  // Out of what was opened last.
  escape() {
    if (!this.$('hint').hidden) this.unfold('help', 'hint', false);
    else if (this.dollhouse.isOpen) this.toggleOutside(false);
    else if (!this.$('measured').hidden) this.measure.clear();
    this.change();
  }

  toggleMeasure(isOn = !this.measure.isOn) {
    if (isOn) this.toggleOutside(false);
    this.measure.toggle(isOn);
    this.change();
  }

  // Out of the walk and around the tour, or back in to where the walker stands by now.
  toggleOutside(isOut = !this.dollhouse.isOpen) {
    const { dollhouse, walker } = this;
    if (isOut === dollhouse.isOpen || !this.renderer || this.$('outside').hidden) return;
    if (isOut) {
      this.measure.toggle(false);
      walker.stop();
      [this.shareInside, this.share] = [this.share, 1];
      dollhouse.open(this.renderer, walker, this.isStill).catch((error) => {
        this.say(`Some of the view from outside is missing: ${error.message}`);
        this.emit('error', error);
      });
      this.controls.walker = dollhouse.orbit;
    } else {
      dollhouse.close(walker, this.isStill, () => this.comeIn());
    }
    this.change();
  }

  comeIn() {
    [this.share, this.controls.walker] = [this.shareInside, this.walker];
    this.change();
  }

  flatten() {
    if (!this.dollhouse.isOpen) return;
    this.dollhouse.flatten(!this.dollhouse.orbit.isFlat);
    this.change();
  }

  readAddress() {
    if (location.hash === this.written) return;
    this.walker.stop();
    this.walker.address = location.hash;
    this.change();
  }

  get headset() {
    return new Headset(this.gl, this.renderer, this.walker, this.world);
  }

  // A button where a panorama was taken: it leads there.
  makeStop({ index, title }) {
    const button = document.createElement('button');
    button.className = 'stop';
    button.title = title;
    button.hidden = true;
    button.setAttribute('aria-label', `Walk to panorama ${index + 1}, ${title}`);
    button.addEventListener('click', () => this.goTo(index));
    this.$('stops').append(button);
    return button;
  }

  get panoramas() {
    return this.world.panoramas.map(({ name, title, caption, position }) => ({ name, title, caption, position }));
  }

  get links() {
    return this.world.links.map(({ ends }) => ends.map((end) => this.world.panoramas[end].name));
  }

  // Where one is, in the frame of poses.json; angles in degrees.
  get place() {
    const { walker } = this, name = (index) => this.world.panoramas[index].name;
    const [yaw, pitch, fov] = [walker.yaw, walker.pitch, walker.fov].map((angle) => angle * 180 / Math.PI);
    return { from: name(walker.link.ends[0]), to: name(walker.link.ends[1]), share: walker.t, nearest: name(walker.nearest), position: walker.position, yaw, pitch, fov };
  }

  // Walks to a panorama, by its name or number; true once it is there, false where something else was done meanwhile.
  goTo(panorama, { isSudden = this.isStill } = {}) {
    const index = typeof panorama === 'number' ? panorama : this.world.panoramas.findIndex(({ name }) => name === panorama);
    if (!this.world.panoramas[index]) return Promise.reject(new Error(`expected a panorama of this walk, got ${panorama}`));
    if (this.ending.signal.aborted) return Promise.resolve(false);
    this.walker.goTo(index, isSudden || this.dollhouse.isOpen);
    this.toggleOutside(false);
    this.change();
    return new Promise((resolve) => { this.arrivals.push({ index, resolve }); });
  }

  // Turns towards angles in degrees, or towards a point of the world.
  lookAt({ yaw, pitch, fov, point }) {
    const { walker } = this;
    if (point) Object.assign(walker, lookOfDirection(minus(point, walker.position)));
    for (const [key, angle] of Object.entries({ yaw, pitch, fov })) if (Number.isFinite(angle)) walker[key] = angle * Math.PI / 180;
    walker.pitch = clamp(walker.pitch, -Math.PI / 2, Math.PI / 2);
    walker.fov = clamp(walker.fov, FIELD.least, FIELD.most);
    this.change();
  }

  togglePlay() {
    this.toggleOutside(false);
    if (this.walker.isPlaying) this.walker.stop();
    else this.walker.play();
    this.change();
  }

  // A ring, a mark, or the way that leads closest to there. The stage has the pointer, so that nothing in it is clicked.
  tap(x, y) {
    const box = this.$('stage').getBoundingClientRect(), at = [(x - box.left) / box.width, (y - box.top) / box.height];
    if (this.measure.isOn) return this.pickAt(...at);
    const button = this.root.elementFromPoint(x, y)?.closest('button');
    if (button) return button.click();
    if (this.dollhouse.isOpen) return null;
    const way = this.walker.wayOut(headingOf(this.rayAt(...at)));
    return way && this.goTo(way.link.ends[way.sense > 0 ? 1 : 0]);
  }

  // The direction in the world of a place in the picture: shares of its width and height, from the upper left corner.
  rayAt(x, y) {
    const lens = lensOf(this.walker.fov, [this.element.clientWidth, this.element.clientHeight]);
    const ray = rotated(this.walker.rotation, [(2 * x - 1) / lens[0], (1 - 2 * y) / lens[1], -1]);
    return times(ray, 1 / length(ray));
  }

  pickAt(x, y) {
    this.measure.pick(x, y);
    this.change();
  }

  // The point that is seen there, `{point, away, std}` with the direction that it was measured in and its standard
  // deviations along and across it; null where depth is not known or may be infinite, undefined before it is unpacked.
  pointAt(x, y) {
    const { walker, world, renderer } = this;
    if (!renderer || !world.isReady(walker.link)) return undefined;
    this.draw(1);
    const { scene, size } = this.drawn, ray = this.rayAt(x, y), { link } = walker;
    if (scene.isCrossFade) return null; // depth is a guess there
    const nearest = Math.round(walker.t), pixel = [x * size[0], (1 - y) * size[1]];
    for (const k of [nearest, 1 - nearest]) {
      const { surface, position, rotation } = scene.views[k];
      const depths = surface ? renderer.depthsAround(k, pixel, size) : [-1], rho = depths[depths.length >> 1];
      if (!(rho > 0)) continue;
      const point = add(walker.position, times(ray, 1 / rho)), from = minus(point, position), distance = length(from);
      const away = times(from, 1 / distance), trust = surface.trustIn(unrotated(rotation, away));
      const stereo = world.inverseDepthStd(link.ends[k], away, trust);
      const step = Math.sqrt(surface.peak / distance) / NO_SURFACE; // of the codes that depth is stored in
      const beside = depths.filter((value) => value > 0); // a click may be off by a pixel
      const aside = (Math.max(...beside) - Math.min(...beside)) / 2 * (distance * rho) ** -2;
      const error = Math.hypot(stereo, step, aside);
      if (2 * error >= 1 / distance) return null;
      const pixels = Math.hypot(walker.fov / size[1], Math.PI / surface.rows) / 2;
      return { point, away, std: [distance ** 2 * error, distance * pixels] };
    }
    return null;
  }

  // Loads what is needed at this place: first a small picture, then all of the link, then what lies beyond it.
  async prepare() {
    const { world, walker, $ } = this;
    this.preparedFor = this.needs;
    const isOpening = this.element.dataset.state === 'loading';
    await world.prepare(walker, (wants) => {
      if (this.element.dataset.state === 'failed' || this.ending.signal.aborted) return;
      const now = wants.filter((want) => want.isNow), done = now.filter((want) => world.things.has(want.key)).length;
      [$('progress').max, $('progress').value] = [now.length, done];
      if (isOpening && !this.fade) this.say(done < now.length ? `Unpacking surfaces, ${done} of ${now.length} …` : '');
      const isDone = done === now.length;
      if (isDone) this.opened();
      if (!this.drawn) this.draw(); // at once, before anything else is unpacked
      if (isDone) this.change(); // pictures on the way cost more than they show
    });
  }

  keepUp() {
    if (this.preparedFor !== this.needs) this.prepareAgain();
  }

  prepareAgain() {
    clearTimeout(this.retrying);
    this.prepare().catch((error) => this.missed(error));
  }

  // Something that this place needs did not come: it is asked for again as long as one stays.
  missed(error) {
    if (this.ending.signal.aborted) return;
    this.isMissing = true;
    this.say(`Something of this place is missing: ${error.message}. Trying again …`);
    this.emit('error', error);
    this.retrying = setTimeout(() => this.prepareAgain(), RETRY);
  }

  opened() {
    this.$('progress').hidden = true;
    this.element.dataset.state = 'ready';
    if (this.isMissing) this.say('');
    this.isMissing = false;
  }

  // What loading depends on.
  get needs() {
    return `${this.walker.link.index} ${this.walker.nearest}`;
  }

  failed(error) {
    if (this.ending.signal.aborted) throw error;
    this.$('progress').hidden = true;
    this.say(`This walk cannot be shown: ${error.message}`);
    this.element.dataset.state = 'failed';
    this.emit('error', error);
    throw error;
  }

  // Tells listeners; false where one of them took it upon itself.
  emit(kind, detail = null) {
    return this.dispatchEvent(new CustomEvent(kind, { detail, cancelable: true }));
  }

  say(words) {
    this.$('status').textContent = words;
    this.$('loading').hidden = words === '';
  }

  change() {
    if (this.isWaiting || this.ending.signal.aborted) return;
    this.isWaiting = true;
    requestAnimationFrame((time) => this.frame(time));
  }

  frame(time) {
    this.isWaiting = false;
    if (this.ending.signal.aborted) return;
    const { walker } = this;
    if (walker.hasMoved) this.element.dataset.moved = '';
    const seconds = this.before === null ? 0 : Math.min((time - this.before) / 1000, 0.5);
    const mover = this.controls.walker, keys = this.controls.advance(seconds), isMoving = mover.advance(seconds) || keys;
    this.before = isMoving || this.controls.held.size ? time : null;
    this.draw();
    this.showPlace();
    this.keepUp();
    if (isMoving || walker.isPlaying || walker.goal !== null) this.change();
    else this.settle();
    this.tellPlace();
  }

  tellPlace() {
    const { walker } = this, { panorama } = walker;
    for (const index of walker.passed.splice(0)) {
      if (index !== this.reached) this.emit('arrive', this.world.panoramas[index].name);
      this.reached = index;
    }
    if (panorama === null) this.reached = null;
    this.arrivals = this.arrivals.filter(({ index, resolve }) => {
      if (walker.goal === index) return true;
      resolve(panorama === index);
      return false;
    });
    if (walker.address === this.told) return;
    this.told = walker.address;
    this.emit('move', this.place);
  }

  // At rest the whole picture is drawn, and the address says where one is.
  settle() {
    clearTimeout(this.settling);
    this.settling = setTimeout(() => {
      if (this.share < 1 && this.element.dataset.state === 'ready') this.draw(1);
      if (!this.options.keepsAddress) return;
      this.written = this.walker.address;
      history.replaceState(null, '', this.written);
    }, 250);
  }

  draw(share = this.share) {
    const sides = [this.element.clientWidth, this.element.clientHeight];
    const ratio = Math.min(window.devicePixelRatio || 1, Math.sqrt(MOST_PIXELS / Math.max(sides[0] * sides[1], 1)));
    const size = sides.map((count) => Math.max(Math.round(count * ratio * share), 16));
    if (this.canvas.width !== size[0] || this.canvas.height !== size[1]) [this.canvas.width, this.canvas.height] = size;
    if (this.fade) this.fade.draw(this.walker, this.world);
    else if (this.renderer) this.drawSurfaces(size);
  }

  drawSurfaces(size) {
    const { walker, world, renderer, gl } = this, isOutside = this.dollhouse?.isOpen;
    const scene = world.sceneAt(walker);
    if (!scene && !isOutside) return;
    const begin = performance.now();
    const eye = { position: walker.position, rotation: walker.rotation, lens: lensOf(walker.fov, size) };
    try {
      if (isOutside) this.dollhouse.draw(size);
      else renderer.draw(eye, scene, { viewport: [0, 0, ...size], unknown: walker.strangeness });
    } catch (error) { // a shader that this browser does not take
      this.renderer = null;
      this.failed(error);
    }
    if (!isOutside) this.drawn = { scene, size };
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4)); // waits, so that it can be timed
    this.milliseconds = performance.now() - begin;
    this.firstPicture ??= performance.now();
    const better = Math.sqrt(SLOW / 2 / Math.max(this.milliseconds, 1));
    this.share = clamp(this.milliseconds > SLOW || this.share < 1 ? this.share * clamp(better, 0.7, 1.1) : 1, 0.35, 1);
  }

  showPlace() {
    const { walker, world, $ } = this;
    const { link, t } = walker, titles = link.ends.map((end) => world.panoramas[end].title);
    $('place').value = world.isChain ? walker.s : t;
    const between = walker.panorama !== null ? titles[t] : `${Math.round(100 * t)} % of the way from ${titles[0]} to ${titles[1]}`;
    $('place').setAttribute('aria-valuetext', between);
    $('play').setAttribute('aria-label', walker.isPlaying ? 'Pause' : 'Play');
    $('play').dataset.state = walker.isPlaying ? 'playing' : 'paused';
    this.stops.forEach((stop, index) => this.placeStop(stop, index));
    this.map.show(walker);
    const size = [this.canvas.clientWidth, this.canvas.clientHeight], lens = lensOf(walker.fov, size);
    if (this.dollhouse.isOpen) this.dollhouse.show(size);
    else this.hotspots.show(walker, lens, size, (pixels) => this.nearestAt(pixels, size));
    this.measure.show(walker, lens, size);
    if (this.named === walker.nearest) return;
    this.named = walker.nearest;
    const { title, caption } = world.panoramas[walker.nearest];
    [$('title').textContent, $('caption').textContent] = [title, caption];
  }

  // The nearest inverse depth that the last picture has at pixels of the element; null where it has none.
  nearestAt(pixels, size) {
    if (!this.renderer || !this.drawn || !pixels.length) return pixels.map(() => null);
    const scaled = pixels.map((pixel) => pixel.map((count, axis) => count * this.drawn.size[axis] / size[axis]));
    return this.renderer.nearestAt(scaled, this.drawn.scene, this.drawn.size);
  }

  // On the ground below where the panorama was taken, if that is in front; nearer ones no lower than one looks.
  placeStop(stop, index) {
    const { walker, world } = this, here = walker.panorama;
    const isNeighbour = here === null ? walker.link.ends.includes(index)
      : index !== here && world.panoramas[here].links.some((link) => link.ends.includes(index));
    if (!isNeighbour) {
      if (!stop.hidden) stop.hidden = true;
      return;
    }
    const from = minus(world.panoramas[index].position, walker.position);
    const away = Math.hypot(from[0], from[2]);
    const seen = unrotated(walker.rotation, [from[0], Math.max(from[1] - world.panoramas[index].eyeHeight, -0.6 * away), from[2]]);
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    const lens = lensOf(walker.fov, [width, height]);
    const [x, y] = [lens[0] * seen[0] / -seen[2], lens[1] * seen[1] / -seen[2]];
    stop.hidden = seen[2] >= 0 || away < 0.05 || Math.abs(x) > 1 || Math.abs(y) > 1;
    if (stop.hidden) return;
    stop.style.transform = `translate(${(x + 1) * width / 2}px, ${(1 - y) * height / 2}px) scale(${clamp(2.5 / away, 0.5, 1.2)})`;
  }

  // What is seen from a pose, for tests and for other programs: see docs/view.md.
  async capture(pose, fov, size) {
    const place = this.world.nearestTo(pose.position);
    await this.world.need(place.link);
    const eye = { ...pose, lens: lensOf(fov * Math.PI / 180, size) };
    return this.renderer.capture(eye, this.world.sceneAt(place), size);
  }

  // Bytes of graphics memory that are taken: panoramas, surfaces, and what is drawn into.
  get graphicsBytes() {
    return this.world.bytes + (this.dollhouse?.bytes ?? 0) + (this.renderer?.bytes ?? 0);
  }

  // Ends it: listeners, pictures and graphics memory go, and the element is empty and can take another walk.
  dispose() {
    if (this.ending.signal.aborted) return;
    this.ending.abort();
    for (const timer of [this.settling, this.retrying]) clearTimeout(timer);
    this.sides?.disconnect();
    this.hotspots?.putAway();
    this.dollhouse?.forgetGraphics();
    this.arrivals.splice(0).forEach(({ resolve }) => resolve(false));
    this.world?.dispose();
    this.gl?.getExtension('WEBGL_lose_context')?.loseContext();
    this.root.replaceChildren();
    this.root.adoptedStyleSheets = [];
    for (const key of ['state', 'moved', 'outside']) delete this.element.dataset[key];
  }
}
