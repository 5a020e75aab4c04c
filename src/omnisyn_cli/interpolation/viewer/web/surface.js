// One panorama's surface on the graphics processor: its grid of inverse depths in tiles, of which those in sight are
// drawn. Quads that are whole are drawn by indices of the grid's own vertices, cut ones quarter by quarter.

const TILE = 64; // quads along a side
const TILE_VERTICES = TILE + 1;
const TILES = `#define TILE_VERTICES ${TILE_VERTICES}\n`;
const [CUT_EDGES, DIAGONAL, REMOVED] = [15, 16, 32]; // bits of a quad's byte

class Surface {
  // `map` has rows, cols, inverse depths, quads, roots of trust (or null), and the inverse depth at both poles: null
  // where the ring around a pole is cut.
  constructor(gl, map) {
    this.gl = gl;
    Object.assign(this, { rows: map.rows, cols: map.cols, peak: map.peak, isGiven: map.isGiven });
    const rows = angles(map.rows, (k) => [Math.sin((k + 0.5) * Math.PI / map.rows), Math.cos((k + 0.5) * Math.PI / map.rows)]);
    const cols = angles(map.cols, (k) => [Math.sin(azimuth(k, map.cols)), -Math.cos(azimuth(k, map.cols))]);
    this.rowAngles = floatTexture(gl, gl.RG32F, gl.RG, map.rows, 1, rows);
    this.colAngles = floatTexture(gl, gl.RG32F, gl.RG, map.cols, 1, cols);
    this.inverseDepth = floatTexture(gl, gl.R32F, gl.RED, map.cols, map.rows, map.inverseDepth);
    this.trust = map.trust && byteTexture(gl, 2 * map.cols, 2 * map.rows, map.trust);
    this.tiles = this.makeTiles(map, rows, cols);
    this.caps = this.makeCaps(map, rows, cols);
  }

  makeTiles({ rows, cols, inverseDepth, quads }, polar, around) {
    const { gl } = this;
    const indices = new Uint16Array(6 * quads.length);
    const cuts = new Uint32Array(quads.length);
    const tiles = [];
    let [index, cut] = [0, 0];
    for (let top = 0; top < rows - 1; top += TILE) {
      for (let left = 0; left < cols; left += TILE) {
        const [bottom, right] = [Math.min(top + TILE, rows - 1), Math.min(left + TILE, cols)];
        const tile = { top, left, firstIndex: index, firstCut: cut, ...boundsOf(top, left, bottom, right, polar, around) };
        let [least, most] = [Infinity, 0];
        for (let row = top; row <= bottom; row++) {
          for (let col = left; col <= right; col++) {
            const rho = Math.max(inverseDepth[row * cols + col % cols], 0);
            least = Math.min(least, rho);
            most = Math.max(most, rho);
          }
        }
        for (let row = top; row < bottom; row++) {
          for (let col = left; col < right; col++) {
            const quad = quads[row * cols + col];
            if (quad & REMOVED) continue;
            if (quad & CUT_EDGES) {
              cuts[cut++] = 16 * (row * cols + col) + (quad & CUT_EDGES);
              continue;
            }
            const a = (row - top) * TILE_VERTICES + col - left;
            const [b, c, d] = [a + 1, a + TILE_VERTICES, a + TILE_VERTICES + 1];
            const corners = quad & DIAGONAL ? [b, c, a, b, d, c] : [a, d, c, a, b, d];
            for (let k = 0; k < 6; k++) indices[index++] = corners[k];
          }
        }
        tiles.push({ ...tile, indexCount: index - tile.firstIndex, cutCount: cut - tile.firstCut, least, most });
      }
    }
    this.triangles = index / 3 + 8 * cut;
    this.bytes = 2 * index + 4 * cut + 4 * quads.length + 4 * rows * cols * (this.trust ? 1 : 0);
    this.indices = buffer(gl, gl.ELEMENT_ARRAY_BUFFER, indices.subarray(0, index));
    this.cuts = buffer(gl, gl.ARRAY_BUFFER, cuts.subarray(0, cut));
    return tiles;
  }

  // A triangle from each edge of the first and last ring to the pole: a smooth fan, or flat wedges where it is cut.
  makeCaps({ rows, cols, inverseDepth, poles }, polar, around) {
    const points = [];
    [0, rows - 1].forEach((row, which) => {
      for (let col = 0; col < cols; col++) {
        const [here, next] = [col, (col + 1) % cols].map((k) => ({
          direction: [polar[2 * row] * around[2 * k], polar[2 * row + 1], polar[2 * row] * around[2 * k + 1]],
          rho: inverseDepth[row * cols + k],
        }));
        if (Math.min(here.rho, next.rho) < 0) continue;
        const wedge = Math.min(here.rho, next.rho), isCut = poles[which] === null;
        const ring = which === 0 ? [next, here] : [here, next];
        points.push(0, which === 0 ? 1 : -1, 0, isCut ? wedge : poles[which]);
        for (const { direction, rho } of ring) points.push(...direction, isCut ? wedge : rho);
      }
    });
    this.capVertices = points.length / 4;
    return buffer(this.gl, this.gl.ARRAY_BUFFER, new Float32Array(points));
  }

  // Those tiles of which something may be seen: no plane through the eye has all of one on its far side.
  inSight(rotation, position, lens) {
    const planes = [
      [lens[0], 0, -lens[2] - 1], [-lens[0], 0, lens[2] - 1], [0, lens[1], -lens[3] - 1], [0, -lens[1], lens[3] - 1],
    ].map((normal) => ({ away: unrotated(rotation, normal), size: length(normal), shift: dot(normal, position) }));
    return this.tiles.filter((tile) => planes.every(({ away, size, shift }) => {
      const angle = Math.acos(clamp(dot(away, tile.centre) / size, -1, 1)) - tile.radius;
      return size * Math.cos(Math.max(angle, 0)) + Math.max(tile.least * shift, tile.most * shift) >= -1e-6;
    }));
  }

  // Of a quarter of a quad in a direction of the panorama, as shaders look it up.
  trustIn(direction) {
    if (!this.trust) return 1;
    const { gl } = this, { yaw, pitch } = lookOfDirection(direction), count = [2 * this.cols, 2 * this.rows];
    const col = (Math.floor((yaw / (2 * Math.PI) + 0.5) * count[0] - 1) + count[0]) % count[0];
    const row = clamp(Math.floor((0.5 - pitch / Math.PI) * count[1]), 0, count[1] - 1);
    const from = attach(gl, gl.createFramebuffer(), this.trust), texel = new Uint8Array(4);
    gl.readPixels(col, row, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, texel);
    gl.deleteFramebuffer(from);
    return (texel[0] / 255) ** 2;
  }

  dispose() {
    const { gl } = this;
    [this.rowAngles, this.colAngles, this.inverseDepth, this.trust].forEach((texture) => gl.deleteTexture(texture));
    [this.indices, this.cuts, this.caps].forEach((one) => gl.deleteBuffer(one));
  }
}

const azimuth = (col, cols) => (col + 0.5) * 2 * Math.PI / cols - Math.PI;

function angles(count, pairOf) {
  const values = new Float32Array(2 * count);
  for (let k = 0; k < count; k++) values.set(pairOf(k), 2 * k);
  return values;
}

// The cone that holds all directions of a tile.
function boundsOf(top, left, bottom, right, polar, around) {
  const [rows, cols] = [[top, (top + bottom) >> 1, bottom], [left, (left + right) >> 1, right]];
  const directions = rows.flatMap((row) => cols.map((col) => {
    const k = col % (around.length / 2);
    return [polar[2 * row] * around[2 * k], polar[2 * row + 1], polar[2 * row] * around[2 * k + 1]];
  }));
  const sum = directions.reduce(add);
  const centre = times(sum, 1 / length(sum));
  const reach = Math.max(...directions.map((direction) => Math.acos(clamp(dot(direction, centre), -1, 1))));
  return { centre, radius: 1.1 * reach + 1e-3 };
}

function buffer(gl, target, values) {
  const made = gl.createBuffer();
  gl.bindVertexArray(null);
  gl.bindBuffer(target, made);
  gl.bufferData(target, values, gl.STATIC_DRAW);
  return made;
}

function texture(gl, wrapS = gl.CLAMP_TO_EDGE, filter = gl.NEAREST) {
  const made = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, made);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, wrapS);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, filter === gl.NEAREST ? gl.NEAREST : gl.LINEAR);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, filter);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  gl.pixelStorei(gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, false);
  gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
  return made;
}

function floatTexture(gl, internal, format, width, height, values) {
  const made = texture(gl);
  gl.texImage2D(gl.TEXTURE_2D, 0, internal, width, height, 0, format, gl.FLOAT, values);
  return made;
}

function byteTexture(gl, width, height, values, wrapS = gl.CLAMP_TO_EDGE, filter = gl.NEAREST) {
  const made = texture(gl, wrapS, filter);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.R8, width, height, 0, gl.RED, gl.UNSIGNED_BYTE, values);
  if (filter !== gl.NEAREST) gl.generateMipmap(gl.TEXTURE_2D);
  return made;
}

// A photograph with its mip levels; it goes around, and ends at the poles.
function photoTexture(gl, bitmap) {
  const most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
  const made = texture(gl, gl.REPEAT, gl.LINEAR_MIPMAP_LINEAR);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, bitmap.width > most ? shrunk(bitmap, most) : bitmap);
  gl.generateMipmap(gl.TEXTURE_2D);
  return made;
}

function shrunk(bitmap, width) {
  const canvas = new OffscreenCanvas(width, width / 2);
  canvas.getContext('2d').drawImage(bitmap, 0, 0, width, width / 2);
  return canvas;
}
