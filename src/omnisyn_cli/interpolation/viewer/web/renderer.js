// A picture from any place: both surfaces drawn into images of inverse depth, coloured and blended, holes filled.

const GUARD = 0.06; // more of the picture on every side than is shown, so that holes at its rim know their surroundings

class Renderer {
  constructor(gl, tables) {
    this.gl = gl;
    if (!gl.getExtension('EXT_color_buffer_float')) throw new Error('expected pictures of floating-point numbers');
    this.coefficients = tables;
    this.plain = this.program(WHOLE_PICTURE, PLAIN_FRAGMENT);
    this.vertices = gl.createVertexArray();
    this.targets = null;
    this.drawn = 0;
  }

  program(vertex, fragment) {
    return new Program(this.gl, HEADER + CONSTANTS + TILES + vertex, HEADER + CONSTANTS + fragment);
  }

  // Compiles what surfaces are drawn with, which takes a while.
  compile() {
    const { gl } = this, program = (...shaders) => this.program(...shaders);
    this.whole = program(WHOLE_VERTEX, SURFACE_FRAGMENT);
    this.quarters = program(QUARTER_VERTEX, SURFACE_FRAGMENT);
    this.cap = program(CAP_VERTEX, SURFACE_FRAGMENT);
    this.blend = program(WHOLE_PICTURE, BLEND_FRAGMENT);
    this.pull = program(WHOLE_PICTURE, PULL_FRAGMENT);
    this.push = program(WHOLE_PICTURE, PUSH_FRAGMENT);
    this.show = program(WHOLE_PICTURE, SHOW_FRAGMENT);
    this.tables = floatTexture(gl, gl.RGBA32F, gl.RGBA, 16, 17, new Float32Array(this.coefficients));
    this.one = byteTexture(gl, 1, 1, new Uint8Array([255]));
  }

  drawPlain({ rotation, lens }, view, viewport) {
    this.endSurfaces();
    this.gl.bindVertexArray(this.vertices);
    this.plain.use({ lens, viewport, photo: view.photo, toSource: columns(product(transposed(view.rotation), rotation)) });
    this.fillPicture();
  }

  // Draws what `eye` (position, rotation, lens) sees of a scene into a framebuffer, or the canvas where that is null.
  // A scene has two views (photo, position, rotation, and perhaps mask, surface, exposure) and the share `t` of the way.
  draw(eye, scene, { framebuffer = null, viewport, unknown = 0 }) {
    const { gl } = this;
    const [width, height] = viewport.slice(2);
    if (scene.isPlain) {
      gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
      gl.viewport(...viewport);
      this.drawPlain(eye, scene.views[Math.round(scene.t)], viewport);
      return;
    }
    if (!this.whole) this.compile();
    const margin = [width, height].map((count) => 2 * Math.ceil(GUARD * count / 2));
    const size = [width + 2 * margin[0], height + 2 * margin[1]];
    const lens = [eye.lens[0] * width / size[0], eye.lens[1] * height / size[1],
      eye.lens[2] * width / size[0], eye.lens[3] * height / size[1]];
    this.render({ ...eye, lens }, scene, size);
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    gl.viewport(...viewport);
    const { levels } = this.targets;
    this.show.use({
      fine: levels[0].pulled, coarse: levels[1].pushed, corner: margin, viewport: viewport.slice(0, 2), unknown,
      lens, seen: this.targets.seen, correction: scene.correction ?? this.one, toWorld: columns(eye.rotation),
      corrected: scene.correction ? 1 - Math.abs(2 * scene.t - 1) : 0,
      middle: scene.correction ? unrotated(eye.rotation, minus(scene.middle, eye.position)) : [0, 0, 0],
    });
    this.fillPicture();
  }

  // The picture before the screen: inverse depths of both surfaces, fused colours, the pyramid of holes.
  render(eye, scene, size) {
    const { gl } = this;
    this.prepareTargets(size);
    const turns = scene.views.map((view) => product(transposed(eye.rotation), view.rotation));
    const offsets = scene.views.map((view) => unrotated(eye.rotation, minus(view.position, eye.position)));
    this.drawn = 0;
    gl.bindVertexArray(this.vertices);
    gl.viewport(0, 0, ...size);
    scene.views.forEach((view, k) => view.surface && this.drawSurface(view.surface, turns[k], offsets[k], eye.lens, size, k));
    this.endSurfaces();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.targets.levels[0].pullInto);
    const { one, targets } = this;
    const rule = ruleAt(scene.t);
    this.blend.use({
      lens: eye.lens, size, seen: targets.seen, photo: scene.views.map((view) => view.photo),
      usable: scene.views.map((view) => view.mask ?? one),
      trust: scene.views.map((view) => view.surface?.trust ?? one),
      exposure: scene.views.map((view) => view.exposure?.gains ?? one),
      toSource: turns.map(transposed).map(columns), offset: offsets.flat(), isCrossFade: scene.isCrossFade ? 1 : 0,
      has: scene.views.flatMap((view) => [view.surface, view.mask, view.surface?.trust, view.exposure].map((x) => (x ? 1 : 0))),
      exposed: scene.views.flatMap((view, k) => [scene.t - k, scene.t === k ? 0 : view.exposure?.lossOfWhite(scene.t) ?? 0]),
      rule: [rule.t, DISAGREEMENT, rule.hidden],
    });
    this.fillPicture();
    this.fillHoles();
  }

  // Clears a framebuffer to a colour. Then the nearest triangle is drawn, of those whose corners go clockwise.
  beginSurfaces(framebuffer, colour) {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    gl.clearColor(...colour);
    gl.clearDepth(0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.GEQUAL);
    gl.enable(gl.CULL_FACE);
    gl.cullFace(gl.BACK);
    gl.frontFace(gl.CW);
  }

  endSurfaces() {
    this.gl.disable(this.gl.DEPTH_TEST);
    this.gl.disable(this.gl.CULL_FACE);
  }

  drawSurface(surface, rotation, position, lens, size, k) {
    const { gl } = this;
    this.beginSurfaces(this.targets.surfaces[k], [-1, 0, 0, 1]);
    const common = { rotation: columns(rotation), position, lens, size };
    const grid = { inverseDepth: surface.inverseDepth, rowAngles: surface.rowAngles, colAngles: surface.colAngles };
    const tiles = surface.inSight(rotation, position, lens);
    this.whole.use({ ...common, ...grid });
    gl.disableVertexAttribArray(0);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, surface.indices);
    for (const tile of tiles) {
      if (!tile.indexCount) continue;
      this.whole.set('origin', [tile.left, tile.top]);
      gl.drawElements(gl.TRIANGLES, tile.indexCount, gl.UNSIGNED_SHORT, 2 * tile.firstIndex);
      this.drawn += tile.indexCount / 3;
    }
    this.quarters.use({ ...common, ...grid, quarterTables: this.tables });
    gl.bindBuffer(gl.ARRAY_BUFFER, surface.cuts);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribDivisor(0, 1);
    for (const tile of tiles) {
      if (!tile.cutCount) continue;
      gl.vertexAttribIPointer(0, 1, gl.UNSIGNED_INT, 0, 4 * tile.firstCut);
      gl.drawArraysInstanced(gl.TRIANGLES, 0, 24, tile.cutCount);
      this.drawn += 8 * tile.cutCount;
    }
    this.cap.use(common);
    gl.bindBuffer(gl.ARRAY_BUFFER, surface.caps);
    gl.vertexAttribDivisor(0, 0);
    gl.vertexAttribPointer(0, 4, gl.FLOAT, false, 0, 0);
    gl.drawArrays(gl.TRIANGLES, 0, surface.capVertices);
    gl.disableVertexAttribArray(0);
  }

  fillHoles() {
    const { gl } = this;
    const { levels } = this.targets;
    for (let k = 1; k < levels.length; k++) {
      gl.bindFramebuffer(gl.FRAMEBUFFER, levels[k].pullInto);
      gl.viewport(0, 0, ...levels[k].size);
      this.pull.use({ fine: levels[k - 1].pulled });
      this.fillPicture();
    }
    for (let k = levels.length - 2; k >= 1; k--) {
      gl.bindFramebuffer(gl.FRAMEBUFFER, levels[k].pushInto);
      gl.viewport(0, 0, ...levels[k].size);
      this.push.use({ fine: levels[k].pulled, coarse: levels[k + 1].pushed });
      this.fillPicture();
    }
  }

  fillPicture() {
    this.gl.drawArrays(this.gl.TRIANGLES, 0, 3);
  }

  // The nearest inverse depth that is seen at pixels of the picture drawn last, the least of three by three around each;
  // null where no surface is drawn. Pixels count from the lower left corner.
  nearestAt(pixels, scene, [width, height]) {
    if (!pixels.length || !this.targets) return [];
    const shown = [0, 1].filter((k) => scene.views[k].surface && scene.t !== 1 - k);
    return pixels.map((pixel) => {
      const around = shown.map((k) => this.depthsAround(k, pixel, [width, height]));
      return shown.length ? Math.min(...around[0].map((_, at) => Math.max(...around.map((values) => values[at])))) : null;
    });
  }

  // Inverse depths of one surface in the picture drawn last, of three by three pixels; negative where it is not.
  depthsAround(k, [x, y], [width, height]) {
    const { gl } = this, values = new Float32Array(36);
    const margin = [(this.targets.size[0] - width) / 2, (this.targets.size[1] - height) / 2];
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.targets.surfaces[k]);
    gl.readPixels(Math.floor(x) - 1 + margin[0], Math.floor(y) - 1 + margin[1], 3, 3, gl.RGBA, gl.FLOAT, values);
    return Array.from({ length: 9 }, (_, at) => values[4 * at]);
  }

  // Bytes of graphics memory of what is drawn into.
  get bytes() {
    const pixels = this.targets ? this.targets.size[0] * this.targets.size[1] : 0;
    return pixels * (4 + 2 * 4 + 8 * MIP_SHARE + 8 * (MIP_SHARE - 1));
  }

  // Colours (8 bits, rows from the top) and inverse depths of both surfaces (negative where there is none).
  capture(eye, scene, [width, height]) {
    const { gl } = this;
    const into = gl.createFramebuffer();
    const picture = texture(gl);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, width, height, 0, gl.RGBA, gl.UNSIGNED_BYTE, null);
    attach(gl, into, picture);
    this.draw(eye, scene, { framebuffer: into, viewport: [0, 0, width, height] });
    const colours = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, colours);
    const margin = [(this.targets.size[0] - width) / 2, (this.targets.size[1] - height) / 2];
    const inverseDepth = this.targets.surfaces.map((surface, k) => {
      const values = new Float32Array(4 * width * height);
      gl.bindFramebuffer(gl.FRAMEBUFFER, surface);
      gl.readPixels(...margin, width, height, gl.RGBA, gl.FLOAT, values);
      return scene.views[k].surface ? upright(values, width, height, 4, 1) : null;
    });
    gl.deleteFramebuffer(into);
    gl.deleteTexture(picture);
    return { width, height, colours: upright(colours, width, height, 4, 4), inverseDepth };
  }

  prepareTargets(size) {
    const { gl } = this;
    if (this.targets && this.targets.size.every((count, k) => count === size[k])) return;
    this.disposeTargets();
    const image = (format, [width, height], filter) => {
      const made = texture(gl, gl.CLAMP_TO_EDGE, filter);
      gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, height);
      return made;
    };
    const depth = gl.createRenderbuffer();
    gl.bindRenderbuffer(gl.RENDERBUFFER, depth);
    gl.renderbufferStorage(gl.RENDERBUFFER, gl.DEPTH_COMPONENT32F, ...size);
    const seen = [image(gl.R32F, size), image(gl.R32F, size)];
    const surfaces = seen.map((one) => attach(gl, gl.createFramebuffer(), one, depth));
    const levels = [];
    for (let level = size; ; level = level.map((count) => Math.ceil(count / 2))) {
      const [pulled, pushed] = [image(gl.RGBA16F, level, gl.LINEAR), levels.length ? image(gl.RGBA16F, level, gl.LINEAR) : null];
      levels.push({
        size: level, pulled, pullInto: attach(gl, gl.createFramebuffer(), pulled),
        pushed, pushInto: pushed && attach(gl, gl.createFramebuffer(), pushed),
      });
      if (Math.max(...level) === 1) break;
    }
    levels.at(-1).pushed = levels.at(-1).pulled; // nothing is left to push into the last
    this.targets = { size, depth, seen, surfaces, levels };
  }

  disposeTargets() {
    if (!this.targets) return;
    const { gl } = this;
    const { depth, seen, surfaces, levels } = this.targets;
    gl.deleteRenderbuffer(depth);
    seen.forEach((one) => gl.deleteTexture(one));
    surfaces.forEach((one) => gl.deleteFramebuffer(one));
    levels.forEach((level) => {
      [level.pulled, level.pushed].forEach((one) => gl.deleteTexture(one));
      [level.pullInto, level.pushInto].forEach((one) => gl.deleteFramebuffer(one));
    });
    this.targets = null;
  }
}

// omnisyn_cli.fusion.blend_rule.BlendRule.at
function ruleAt(t) {
  const x = Math.min(1, Math.min(t, 1 - t) / ENDS);
  return { t, hidden: HIDDEN ** (x * x * (3 - 2 * x)) };
}

const columns = (r) => transposed(r); // as WebGL takes matrices

// Focal lengths and centre of a lens in units of half a picture.
function lensOf(fov, [width, height]) {
  const focal = 1 / Math.tan(fov / 2);
  return [focal * height / width, focal, 0, 0];
}

function attach(gl, framebuffer, colour, depth = null) {
  gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, colour, 0);
  if (depth) gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.RENDERBUFFER, depth);
  return framebuffer;
}

// Rows from the top, `kept` of `channels` numbers of each pixel.
function upright(values, width, height, channels, kept) {
  const turned = new values.constructor(kept * width * height);
  for (let row = 0; row < height; row++) {
    for (let col = 0; col < width; col++) {
      for (let k = 0; k < kept; k++) {
        turned[(row * width + col) * kept + k] = values[((height - 1 - row) * width + col) * channels + k];
      }
    }
  }
  return turned;
}

class Program {
  constructor(gl, vertex, fragment) {
    this.gl = gl;
    this.program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(this.program, shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) throw new Error(gl.getShaderInfoLog(shader));
    }
    gl.linkProgram(this.program);
    if (!gl.getProgramParameter(this.program, gl.LINK_STATUS) && !gl.isContextLost()) throw new Error(gl.getProgramInfoLog(this.program));
    this.uniforms = new Map();
    let unit = 0;
    const count = gl.getProgramParameter(this.program, gl.ACTIVE_UNIFORMS) ?? 0;
    for (let k = 0; k < count; k++) {
      const { name, type, size } = gl.getActiveUniform(this.program, k);
      const isImage = type === gl.SAMPLER_2D;
      this.uniforms.set(name.replace('[0]', ''), { at: gl.getUniformLocation(this.program, name), type, size, unit });
      if (isImage) unit += size;
    }
  }

  use(values) {
    this.gl.useProgram(this.program);
    for (const [name, value] of Object.entries(values)) this.set(name, value);
  }

  set(name, value) {
    const { gl } = this;
    const uniform = this.uniforms.get(name);
    if (!uniform) return; // a shader that does not ask
    const { at, type, unit } = uniform;
    if (type === gl.SAMPLER_2D) {
      const images = [value].flat();
      images.forEach((image, k) => {
        gl.activeTexture(gl.TEXTURE0 + unit + k);
        gl.bindTexture(gl.TEXTURE_2D, image);
      });
      gl.uniform1iv(at, images.map((_, k) => unit + k));
    } else if (type === gl.FLOAT_MAT3) gl.uniformMatrix3fv(at, false, value.flat());
    else if (type === gl.FLOAT) gl.uniform1f(at, value);
    else if (type === gl.FLOAT_VEC2) gl.uniform2fv(at, value);
    else if (type === gl.FLOAT_VEC3) gl.uniform3fv(at, value);
    else if (type === gl.FLOAT_VEC4) gl.uniform4fv(at, value);
    else if (type === gl.INT_VEC2) gl.uniform2iv(at, value);
    else if (type === gl.INT_VEC4) gl.uniform4iv(at, value);
    else throw new Error(`expected a known type of ${name}`);
  }
}
