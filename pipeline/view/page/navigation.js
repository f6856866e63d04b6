// Moving about: drag to orbit, right drag or two fingers to shift, wheel or pinch to approach, W A S D Q E to fly.

import { add, length, moved, orbited, poseOf, rotated } from "./camera.js";

const ORBIT = 0.006; // radians a pixel
const FLY = 0.5; // of the distance to the middle, a second

export class Navigation {
    constructor(scene, state, element) {
        Object.assign(this, { scene, state, element });
        this.pointers = new Map();
        this.keys = new Set();
        element.addEventListener("pointerdown", (event) => this.down(event));
        element.addEventListener("pointermove", (event) => this.move(event));
        for (const end of ["pointerup", "pointercancel"])
            element.addEventListener(end, (event) => this.pointers.delete(event.pointerId));
        element.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
        element.addEventListener("contextmenu", (event) => event.preventDefault());
        addEventListener("blur", () => this.keys.clear());
    }

    reset() {
        this.state.set({ camera: null, pose: poseOf(this.scene.cameras[this.scene.reference].world_to_cam) });
    }

    // The pose from which to move on. A move from a camera of the data set leaves it.
    pose() {
        const { camera, pose } = this.state;
        return camera === null ? pose : poseOf(this.scene.cameras[camera].world_to_cam);
    }

    leaveFor(pose) {
        this.state.set({ camera: null, pose, compare: "render" });
    }

    down(event) {
        if (event.target.closest("[data-no-drag]")) return;
        this.element.setPointerCapture(event.pointerId);
        this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    }

    move(event) {
        const before = this.pointers.get(event.pointerId);
        if (!before) return;
        const now = [event.clientX, event.clientY];
        const by = add(now, before, -1);
        if (this.pointers.size === 1) {
            if (event.shiftKey || event.buttons & 6) this.shift(by);
            else if (event.ctrlKey) this.look(by);
            else this.orbit(-by[0] * ORBIT, -by[1] * ORBIT);
        } else {
            const [other] = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
            this.shift(by.map((x) => 0.5 * x));
            this.approach(length(add(now, other, -1)) / Math.max(1, length(add(before, other, -1))));
        }
        this.pointers.set(event.pointerId, now);
    }

    wheel(event) {
        if (event.target.closest("[data-no-drag]")) return;
        event.preventDefault();
        this.approach(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)));
    }

    orbit(yaw, pitch) {
        this.leaveFor(orbited(this.pose(), this.scene.middle, this.scene.up, yaw, pitch));
    }

    look(by) {
        const pose = this.pose();
        const turned = rotated(pose, pose.position, this.scene.up, by[0] * 0.5 * ORBIT);
        this.leaveFor(rotated(turned, turned.position, turned.right, -by[1] * 0.5 * ORBIT));
    }

    shift(by) {
        const pixel = this.distance() / Math.max(1, this.element.clientHeight);
        this.leaveFor(moved(this.pose(), -by[0] * pixel, -by[1] * pixel, 0));
    }

    approach(factor) {
        this.leaveFor(moved(this.pose(), 0, 0, this.distance() * (1 - 1 / factor)));
    }

    distance() {
        return Math.max(length(add(this.pose().position, this.scene.middle, -1)), 0.05 * this.scene.size);
    }

    // Called every frame with the seconds since the last one.
    fly(seconds) {
        const held = (key) => (this.keys.has(key) ? 1 : 0);
        const [right, down, forward] = [held("d") - held("a"), held("q") - held("e"), held("w") - held("s")];
        if (!right && !down && !forward) return;
        const step = seconds * FLY * this.scene.size * (this.keys.has("shift") ? 3 : 1);
        this.leaveFor(moved(this.pose(), right * step, down * step, forward * step));
    }
}
