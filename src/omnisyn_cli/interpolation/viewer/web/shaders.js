// What the graphics processor does. `CONSTANTS` are lines of `#define` that the program writes from its own rules.

const HEADER = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
const float PI = 3.14159265359;
`;

// A homogeneous point of a surface, direction and inverse depth: `rotation · direction + inverse depth · position`.
// Infinitely far is an inverse depth of 0; the depth buffer has near · inverse depth along z, the greatest wins.
const PROJECTION = `
uniform mat3 rotation;
uniform vec3 position;
uniform vec4 lens;
out float inverseDepthOfPoint;

void project(vec4 point) {
  vec3 seen = rotation * point.xyz + point.w * position;
  inverseDepthOfPoint = point.w;
  gl_Position = vec4(lens.xy * seen.xy - lens.zw * seen.z, NEAR * point.w, -seen.z);
}

void leaveOut() {
  inverseDepthOfPoint = 0.0;
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
}
`;

const GRID = `
uniform sampler2D inverseDepth;
uniform sampler2D rowAngles;
uniform sampler2D colAngles;

vec4 vertexOf(ivec2 place) {
  int cols = textureSize(inverseDepth, 0).x;
  int col = place.x < cols ? place.x : place.x - cols;
  vec2 polar = texelFetch(rowAngles, ivec2(place.y, 0), 0).rg;
  vec2 around = texelFetch(colAngles, ivec2(col, 0), 0).rg;
  float rho = texelFetch(inverseDepth, ivec2(col, place.y), 0).r;
  return vec4(polar.x * around.x, polar.y, polar.x * around.y, rho);
}
`;

// Whole quads of a tile of the grid, by indices of its own vertices.
const WHOLE_VERTEX = `${PROJECTION}${GRID}
uniform ivec2 origin;

void main() {
  project(vertexOf(origin + ivec2(gl_VertexID % TILE_VERTICES, gl_VertexID / TILE_VERTICES)));
}
`;

// Quarters of quads with cut edges: each is an instance of 24 vertices; tables say how points follow from corners.
const QUARTER_VERTEX = `${PROJECTION}${GRID}
uniform sampler2D quarterTables;
layout(location = 0) in uint quad;

const int TRIANGLES[6] = int[6](0, 3, 2, 0, 1, 3);

void main() {
  int cols = textureSize(inverseDepth, 0).x;
  int place = int(quad >> 4u), code = int(quad & 15u), quarter = gl_VertexID / 6;
  ivec2 corner = ivec2(place % cols, place / cols);
  vec4 corners[4] = vec4[4](vertexOf(corner), vertexOf(corner + ivec2(1, 0)), vertexOf(corner + ivec2(0, 1)),
    vertexOf(corner + ivec2(1, 1)));
  vec4 rho = vec4(corners[0].w, corners[1].w, corners[2].w, corners[3].w);
  bool isDrawn = true;
  for (int point = 0; point < 4; point++)
    if (dot(texelFetch(quarterTables, ivec2(4 * quarter + point, code), 0), rho) < 0.0) isDrawn = false;
  if (!isDrawn) { leaveOut(); return; }
  int point = 4 * quarter + TRIANGLES[gl_VertexID % 6];
  vec4 weights = texelFetch(quarterTables, ivec2(point, 16), 0);
  vec3 direction = weights.x * corners[0].xyz + weights.y * corners[1].xyz + weights.z * corners[2].xyz
    + weights.w * corners[3].xyz;
  project(vec4(direction, dot(texelFetch(quarterTables, ivec2(point, code), 0), rho)));
}
`;

const CAP_VERTEX = `${PROJECTION}
layout(location = 0) in vec4 point;

void main() { project(point); }
`;

const SURFACE_FRAGMENT = `
uniform vec4 lens;
uniform vec2 size;
in float inverseDepthOfPoint;
out vec4 seen;

void main() {
  vec2 ray = (2.0 * gl_FragCoord.xy / size - 1.0 - lens.zw) / lens.xy;
  seen = vec4(max(inverseDepthOfPoint * gl_FragCoord.w, 0.0) / length(vec3(ray, 1.0)), 0.0, 0.0, 1.0);
}
`;

// A coarse mesh from outside, in perspective; or flat, as seen from `flatAt` metres above, where that is not 0.
const OUTSIDE_VERTEX = `
uniform mat3 rotation;
uniform vec3 position;
uniform vec4 lens;
uniform float flatAt;
layout(location = 0) in vec3 point;
layout(location = 1) in vec2 placeInPhoto;
out vec2 place;

void main() {
  vec3 seen = rotation * point + position;
  place = placeInPhoto;
  gl_Position = flatAt > 0.0 ? vec4(lens.xy * seen.xy, flatAt + 0.5 * seen.z, flatAt)
    : vec4(lens.xy * seen.xy, NEAR, -seen.z);
}
`;

const OUTSIDE_FRAGMENT = `
uniform sampler2D photo;
in vec2 place;
out vec4 shown;

void main() { shown = vec4(texture(photo, place).rgb, 1.0); }
`;

const WHOLE_PICTURE = `
void main() { gl_Position = vec4(4.0 * float(gl_VertexID & 1) - 1.0, 2.0 * float(gl_VertexID & 2) - 1.0, 0.0, 1.0); }
`;

const PLACE = `
vec2 placeOf(vec3 direction) {
  return vec2(atan(direction.x, -direction.z) / (2.0 * PI) + 0.5,
    atan(length(direction.xz), direction.y) / PI);
}
`;

// One photograph, seen from where it was taken: a small shader, which is there early.
const PLAIN_FRAGMENT = `${PLACE}
uniform vec4 lens;
uniform vec4 viewport;
uniform sampler2D photo;
uniform mat3 toSource;
out vec4 shown;

void main() {
  vec2 slope = (2.0 * (gl_FragCoord.xy - viewport.xy) / viewport.zw - 1.0 - lens.zw) / lens.xy;
  shown = vec4(textureLod(photo, placeOf(toSource * vec3(slope, -1.0)), 0.0).rgb, 1.0);
}
`;

// Both surfaces coloured and blended: red, green, blue, and the fourth root of how much the pixel counts for holes.
const BLEND_FRAGMENT = `${PLACE}
uniform vec4 lens;
uniform vec2 size;
uniform sampler2D seen[2];
uniform sampler2D photo[2];
uniform sampler2D usable[2];
uniform sampler2D trust[2];
uniform sampler2D exposure[2];
uniform mat3 toSource[2];
uniform vec3 offset[2];
uniform ivec4 has[2]; // a surface, a mask, trust, another exposure
uniform vec2 exposed[2]; // share of the way from its own end, share of its weight that white loses
uniform vec3 rule; // t, disagreement, hidden
uniform float isCrossFade;
out vec4 fused;

float light(float stored) { return stored <= 0.04045 ? stored / 12.92 : pow((stored + 0.055) / 1.055, 2.4); }
float stored(float light) { return light <= 0.0031308 ? 12.92 * light : 1.055 * pow(light, 1.0 / 2.4) - 0.055; }

// Catmull-Rom interpolation of four by four texels, by nine bilinear lookups.
vec3 bicubic(sampler2D image, vec2 place) {
  vec2 texels = vec2(textureSize(image, 0)), at = place * texels, centre = floor(at - 0.5) + 0.5, f = at - centre;
  vec2 w0 = f * (-0.5 + f * (1.0 - 0.5 * f)), w1 = 1.0 + f * f * (-2.5 + 1.5 * f);
  vec2 w2 = f * (0.5 + f * (2.0 - 1.5 * f)), w3 = f * f * (-0.5 + 0.5 * f), middle = w1 + w2;
  vec2 x[3] = vec2[3]((centre - 1.0) / texels, (centre + w2 / middle) / texels, (centre + 2.0) / texels);
  vec2 w[3] = vec2[3](w0, middle, w3);
  vec3 sum = vec3(0.0);
  for (int row = 0; row < 3; row++)
    for (int col = 0; col < 3; col++)
      sum += w[col].x * w[row].y * textureLod(image, vec2(x[col].x, x[row].y), 0.0).rgb;
  return sum;
}

vec3 colourOf(sampler2D image, vec2 place, float level) {
  return level > MAX_FULL_RESOLUTION_LEVEL ? textureLod(image, place, level).rgb : bicubic(image, place);
}

float trustAt(sampler2D image, vec2 place) {
  ivec2 count = textureSize(image, 0);
  ivec2 quarter = ivec2(floor(vec2(place.x * float(count.x) - 1.0, place.y * float(count.y))));
  float root = texelFetch(image, ivec2((quarter.x + count.x) % count.x, clamp(quarter.y, 0, count.y - 1)), 0).r;
  return root * root;
}

vec4 exposedBy(sampler2D gains, vec2 how, vec4 colour) {
  float brightest = max(colour.r, max(colour.g, colour.b));
  float clipped = clamp((brightest - CLIPPING_SRGB) / (1.0 - CLIPPING_SRGB), 0.0, 1.0);
  for (int k = 0; k < 3; k++) {
    float stops = how.x * texture(gains, vec2((clamp(colour[k], 0.0, 1.0) * 255.0 + 0.5) / 256.0, 0.5))[k];
    colour[k] = min(stored(light(max(colour[k], 0.0)) * exp2(stops)), 1.0);
  }
  return vec4(colour.rgb, colour.a * (1.0 - how.y * clipped));
}

// Colour and weight of what a surface shows on a ray, at an inverse depth.
vec4 shaded(sampler2D photo, sampler2D usable, sampler2D trust, sampler2D gains, mat3 turn, vec3 offset, ivec4 has,
    vec2 how, vec3 ray, float rho, float angle) {
  if (rho < 0.0) return vec4(0.0);
  vec3 away = ray - rho * offset;
  vec2 place = placeOf(turn * away);
  float level = log2(angle / PI * float(textureSize(photo, 0).y) / max(length(away), 1e-10));
  level = max((1.0 - MIP_BIAS) * level, level - MIP_BIAS);
  vec4 colour = vec4(colourOf(photo, place, level), 1.0);
  if (has.y == 1) colour.a = textureLod(usable, place, max(level, 0.0)).r;
  if (has.z == 1) colour.a *= trustAt(trust, place);
  return has.w == 1 ? exposedBy(gains, how, colour) : colour;
}

float proximity(float rho, vec3 ray, vec3 offset) {
  vec3 away = ray - rho * offset;
  float squared = dot(away, away) + 1e-8;
  return 1.0 / (squared * sqrt(squared));
}

// The twin of omnisyn_cli.fusion.blend_rule.view_weights.
vec2 viewWeights(vec2 weight, vec2 near, vec3 ray) {
  float a = weight.x > MIN_VISIBLE_WEIGHT ? weight.x * proximity(near.x, ray, offset[0]) : 0.0;
  float b = weight.y > MIN_VISIBLE_WEIGHT ? weight.y * proximity(near.y, ray, offset[1]) : 0.0;
  float gap = (near.x - near.y) / (max(near.x, near.y) * rule.y + 1e-9);
  float depthConfidence = min(1.0, DEPTH_CONFIDENCE_GAIN * (gap > 0.0 ? weight.x : weight.y));
  float rest = 1.0 - depthConfidence * (1.0 - max(exp(-min(gap * gap, 80.0)), rule.z));
  if (min(a, b) <= 0.0) return vec2(a, b);
  return vec2(a * (1.0 - rule.x) * (gap < 0.0 ? rest : 1.0), b * rule.x * (gap < 0.0 ? 1.0 : rest));
}

void main() {
  vec2 slope = (2.0 * gl_FragCoord.xy / size - 1.0 - lens.zw) / lens.xy;
  float reach = length(vec3(slope, 1.0));
  vec3 ray = vec3(slope, -1.0) / reach;
  float angle = 2.0 / sqrt(lens.x * lens.y * size.x * size.y) * pow(reach, -1.5);
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  vec2 rho = vec2(has[0].x == 1 ? texelFetch(seen[0], pixel, 0).r : 0.0,
    has[1].x == 1 ? texelFetch(seen[1], pixel, 0).r : 0.0);
  vec4 first = vec4(0.0), second = vec4(0.0); // a cross-fade shows only one photograph at its ends
  if (isCrossFade < 0.5 || rule.x < 1.0)
    first = shaded(photo[0], usable[0], trust[0], exposure[0], toSource[0], offset[0], has[0], exposed[0], ray, rho.x,
      angle);
  if (isCrossFade < 0.5 || rule.x > 0.0)
    second = shaded(photo[1], usable[1], trust[1], exposure[1], toSource[1], offset[1], has[1], exposed[1], ray,
      rho.y, angle);
  vec2 near = max(rho, 0.0);
  vec2 weights = isCrossFade > 0.5 ? vec2(1.0 - rule.x, rule.x) * vec2(first.a, second.a)
    : viewWeights(vec2(first.a, second.a), near, ray);
  float total = weights.x + weights.y;
  if (!(total > 0.0)) { fused = vec4(0.0); return; }
  vec2 shares = weights / total;
  float far = FAR_WEIGHT_OFFSET / (dot(shares, near) + FAR_WEIGHT_OFFSET);
  fused = vec4(max(shares.x * first.rgb + shares.y * second.rgb, 0.0), far);
}
`;

// Holes are filled from their far side: weighted means go down, colours come up where there was nothing.
const PULL_FRAGMENT = `
uniform sampler2D fine;
out vec4 mean;

void main() {
  ivec2 first = 2 * ivec2(gl_FragCoord.xy), last = textureSize(fine, 0) - 1;
  vec4 sum = vec4(0.0);
  for (int k = 0; k < 4; k++) {
    ivec2 at = first + ivec2(k & 1, k >> 1);
    if (at.x > last.x || at.y > last.y) continue;
    vec4 value = texelFetch(fine, at, 0);
    float weight = value.a * value.a * value.a * value.a;
    sum += vec4(weight * value.rgb, weight);
  }
  mean = sum.a > 0.0 ? vec4(sum.rgb / sum.a, sqrt(sqrt(sum.a))) : vec4(0.0);
}
`;

const PUSHED = `
vec4 pushed(sampler2D coarse, ivec2 pixel) {
  ivec2 last = textureSize(coarse, 0) - 1, at = pixel / 2, beside = clamp(at + 2 * (pixel & 1) - 1, ivec2(0), last);
  ivec2 places[4] = ivec2[4](at, ivec2(beside.x, at.y), ivec2(at.x, beside.y), beside);
  vec4 parts = vec4(0.5625, 0.1875, 0.1875, 0.0625), sum = vec4(0.0);
  for (int k = 0; k < 4; k++) {
    vec4 value = texelFetch(coarse, places[k], 0);
    float weight = parts[k] * value.a * value.a * value.a * value.a;
    sum += vec4(weight * value.rgb, weight);
  }
  return sum.a > 0.0 ? vec4(sum.rgb / sum.a, sqrt(sqrt(0.25 * sum.a))) : vec4(0.0);
}
`;

const PUSH_FRAGMENT = `${PUSHED}
uniform sampler2D fine;
uniform sampler2D coarse;
out vec4 filled;

void main() {
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  vec4 value = texelFetch(fine, pixel, 0);
  filled = value.a > 0.0 ? value : pushed(coarse, pixel);
}
`;

// To the screen: the middle of the picture, holes filled; far from the way what nobody saw fades to grey. What a video
// has half way beyond the rule is added there, and less towards both ends: it lies on the nearest surface.
const SHOW_FRAGMENT = `${PUSHED}${PLACE}
uniform vec4 lens;
uniform sampler2D seen[2];
uniform sampler2D correction;
uniform float corrected;
uniform mat3 toWorld;
uniform vec3 middle;
uniform sampler2D fine;
uniform sampler2D coarse;
uniform ivec2 corner;
uniform ivec2 viewport;
uniform float unknown;
out vec4 shown;

void main() {
  ivec2 pixel = ivec2(gl_FragCoord.xy) - viewport + corner;
  vec4 value = texelFetch(fine, pixel, 0);
  vec3 colour = value.rgb;
  if (value.a <= 0.0) {
    colour = pushed(coarse, pixel).rgb;
    vec2 place = (vec2(pixel) + 0.5) / vec2(textureSize(fine, 0));
    float known = clamp(4.0 * textureLod(coarse, place, 0.0).a, 0.0, 1.0);
    colour = mix(colour, vec3(0.25 * dot(colour, vec3(0.3, 0.6, 0.1)) + 0.08), unknown * (1.0 - 0.5 * known));
  }
  if (corrected > 0.0) {
    vec2 slope = (2.0 * (vec2(pixel) + 0.5) / vec2(textureSize(fine, 0)) - 1.0 - lens.zw) / lens.xy;
    float rho = max(max(texelFetch(seen[0], pixel, 0).r, texelFetch(seen[1], pixel, 0).r), 0.0);
    vec3 away = normalize(vec3(slope, -1.0)) - rho * middle;
    vec3 change = 255.0 * textureLod(correction, placeOf(toWorld * away), 0.0).rgb - NO_CORRECTION;
    colour = max(colour + corrected / CORRECTION_SCALE * change, 0.0);
  }
  shown = vec4(colour, 1.0);
}
`;
