// Vectors, rotations and the world's angles. Frames as everywhere in omnisyn: x right, y up, −z forward; a rotation is
// nine numbers, row after row, and takes directions of a camera to those of the world.

const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const times = (a, number) => [a[0] * number, a[1] * number, a[2] * number];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const length = (a) => Math.hypot(a[0], a[1], a[2]);
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
const mixed = (a, b, share) => add(times(a, 1 - share), times(b, share));

const rotated = (r, a) => [0, 3, 6].map((k) => r[k] * a[0] + r[k + 1] * a[1] + r[k + 2] * a[2]);
const unrotated = (r, a) => [0, 1, 2].map((k) => r[k] * a[0] + r[k + 3] * a[1] + r[k + 6] * a[2]);
const product = (a, b) => [0, 1, 2].flatMap((row) => [0, 1, 2].map((col) =>
  [0, 1, 2].reduce((sum, k) => sum + a[3 * row + k] * b[3 * k + col], 0)));
const transposed = (r) => [r[0], r[3], r[6], r[1], r[4], r[7], r[2], r[5], r[8]];

// Of an eye that is turned by `yaw` to the right of −z and looks up by `pitch`, in radians.
function rotationOfLook(yaw, pitch) {
  const [cy, sy, cp, sp] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
  return [cy, -sy * sp, -sy * cp, 0, cp, -sp, sy, cy * sp, cy * cp];
}

// Yaw and pitch of a direction in the world.
const lookOfDirection = (d) => ({ yaw: Math.atan2(d[0], -d[2]), pitch: Math.atan2(d[1], Math.hypot(d[0], d[2])) });

// Of a unit quaternion, as WebXR gives it.
function rotationOfQuaternion({ x, y, z, w }) {
  return [
    1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
    2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
    2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y),
  ];
}
