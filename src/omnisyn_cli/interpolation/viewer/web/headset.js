// Walking with a headset (WebXR): the same renderer, once for each eye; metres are metres.

class Headset {
  static async isThere() {
    return Boolean(window.isSecureContext && await navigator.xr?.isSessionSupported('immersive-vr').catch(() => false));
  }

  constructor(gl, renderer, walker, world) {
    Object.assign(this, { gl, renderer, walker, world });
  }

  async enter(onEnd, onFrame, signal) {
    const { gl } = this;
    await gl.makeXRCompatible();
    const session = await navigator.xr.requestSession('immersive-vr', { optionalFeatures: ['local-floor'] });
    session.updateRenderState({ baseLayer: new XRWebGLLayer(session, gl, { depth: false, antialias: false }) });
    const space = await session.requestReferenceSpace('local');
    session.addEventListener('end', onEnd);
    signal.addEventListener('abort', () => session.end().catch(() => {})); // which may have ended before
    session.addEventListener('select', () => {
      const way = this.walker.wayOut(headingOf(this.walker.ahead));
      if (way) this.walker.goTo(way.link.ends[way.sense > 0 ? 1 : 0], false);
    });
    let before = null;
    const frame = (time, xr) => {
      session.requestAnimationFrame(frame);
      this.walker.advance(before === null ? 0 : (time - before) / 1000);
      before = time;
      onFrame();
      this.draw(session, xr.getViewerPose(space));
    };
    session.requestAnimationFrame(frame);
    return session;
  }

  draw(session, pose) {
    if (!pose) return;
    const { baseLayer } = session.renderState;
    const scene = this.world.sceneAt(this.walker);
    if (!scene) return;
    const turn = rotationOfLook(this.walker.yaw, 0);
    for (const view of pose.views) {
      const { position, orientation } = view.transform;
      const m = view.projectionMatrix; // columns
      const eye = {
        position: add(this.walker.position, rotated(turn, [position.x, position.y, position.z])),
        rotation: product(turn, rotationOfQuaternion(orientation)),
        lens: [m[0], m[5], -m[8], -m[9]],
      };
      const { x, y, width, height } = baseLayer.getViewport(view);
      this.renderer.draw(eye, scene, { framebuffer: baseLayer.framebuffer, viewport: [x, y, width, height] });
    }
  }
}
