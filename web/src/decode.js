// Clips as they come over the wire, made ready to draw.

function bytes(text) {
  const raw = atob(text);
  const out = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) out[i] = raw.charCodeAt(i);
  return out.buffer;
}

export function floats(text) {
  return new Float32Array(bytes(text));
}

export function integers(text) {
  return new Uint32Array(bytes(text));
}

/** A clip with its numbers unpacked: `poses` or `states` as Float32Array, `images` as Image, `count` frames. */
export function unpack(clip, scene) {
  if (clip.poses !== undefined) {
    const poses = floats(clip.poses);
    return { ...clip, poses, count: Math.max(1, Math.floor(poses.length / (7 * scene.bodies))) };
  }
  if (clip.frames !== undefined) {
    const images = clip.frames.map((address) => {
      const image = new Image();
      image.src = address;
      return image;
    });
    return { ...clip, images, count: Math.max(1, images.length) };
  }
  const states = floats(clip.states ?? "");
  const width = scene.names?.length || Math.max(1, Math.round(states.length / Math.max(1, clip.steps)));
  return { ...clip, states, width, count: Math.max(1, Math.floor(states.length / width)) };
}
