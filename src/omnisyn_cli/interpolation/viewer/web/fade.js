// Where there is no WebGL2: the panoramas themselves, unrolled and cross-faded, which turn and zoom.

class FlatFade {
  constructor(canvas) {
    this.paper = canvas.getContext('2d');
  }

  draw(walker, world) {
    const { canvas } = this.paper;
    const { link, t } = walker;
    this.paper.fillRect(0, 0, canvas.width, canvas.height);
    [[link.ends[0], 1], [link.ends[1], t]].forEach(([index, share]) => {
      const { rotation } = world.panoramas[index], bitmap = world.pictureOf(index)?.bitmap;
      if (!bitmap || share <= 0) return;
      const scale = canvas.height / (bitmap.height * walker.fov / Math.PI);
      const own = lookOfDirection(unrotated(rotation, rotated(walker.rotation, [0, 0, -1])));
      const [width, height] = [bitmap.width * scale, bitmap.height * scale];
      const left = canvas.width / 2 - (own.yaw / (2 * Math.PI) + 0.5) * width;
      const top = canvas.height / 2 - (0.5 - own.pitch / Math.PI) * height;
      this.paper.globalAlpha = share;
      for (let turn = -2; turn <= 2; turn++) this.paper.drawImage(bitmap, left + turn * width, top, width, height);
    });
    this.paper.globalAlpha = 1;
  }
}
