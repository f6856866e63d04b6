// Pinhole cameras, x right, y down, z forward: how they are read, turned, moved and fitted into a window.

export const add = (a, b, s = 1) => a.map((x, i) => x + s * b[i]);
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const length = (a) => Math.hypot(...a);
export const normalised = (a) => a.map((x) => x / (length(a) || 1));

// Pose: { right, down, forward, position } in the world.
export function poseOf(worldToCam) {
    const [right, down, forward] = [0, 4, 8].map((row) => worldToCam.slice(row, row + 3));
    const t = [worldToCam[3], worldToCam[7], worldToCam[11]];
    const position = [0, 1, 2].map((i) => -(right[i] * t[0] + down[i] * t[1] + forward[i] * t[2]));
    return { right, down, forward, position };
}

// What the renderer takes, from a pose and { width, height, fx, fy, cx, cy }.
export function cameraOf(pose, { width, height, fx, fy, cx, cy }) {
    const rotation = [...pose.right, ...pose.down, ...pose.forward];
    return { width, height, fx, fy, cx, cy, rotation, position: pose.position };
}

// The intrinsics with which a camera's picture just fits into width × height pixels; more is seen at two sides.
export function fitted(intrinsics, width, height) {
    const scale = Math.min(width / intrinsics.width, height / intrinsics.height);
    return {
        width,
        height,
        scale,
        fx: intrinsics.fx * scale,
        fy: intrinsics.fy * scale,
        cx: width / 2 + (intrinsics.cx - intrinsics.width / 2) * scale,
        cy: height / 2 + (intrinsics.cy - intrinsics.height / 2) * scale,
    };
}

function turned(v, axis, angle) {
    const [c, s] = [Math.cos(angle), Math.sin(angle)];
    const along = dot(axis, v) * (1 - c);
    const across = cross(axis, v);
    return v.map((x, i) => x * c + across[i] * s + axis[i] * along);
}

// The pose rotated about `point`, by `angle` about `axis`.
export function rotated(pose, point, axis, angle) {
    const forward = normalised(turned(pose.forward, axis, angle));
    const right = normalised(cross(turned(pose.down, axis, angle), forward));
    return {
        right,
        down: cross(forward, right),
        forward,
        position: add(point, turned(add(pose.position, point, -1), axis, angle)),
    };
}

// About the scene's vertical through `point`, then up or down as far as the vertical itself.
export function orbited(pose, point, up, yaw, pitch) {
    const around = rotated(pose, point, up, yaw);
    const tilted = rotated(around, point, around.right, pitch);
    return Math.abs(dot(tilted.forward, up)) < 0.995 ? tilted : around;
}

export function moved(pose, right, down, forward) {
    let position = add(pose.position, pose.right, right);
    position = add(position, pose.down, down);
    return { ...pose, position: add(position, pose.forward, forward) };
}
