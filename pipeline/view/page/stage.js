// Turns the state into pictures: which camera, at which time, in every pane at once.

import { cameraOf, fitted, poseOf } from "./camera.js";

const MOST_PIXELS = 2.5e6; // of a free view
const SLOW_MS = 60; // between pictures; while it takes longer, a free view that moves is drawn in fewer pixels
const FAST_MS = 30;
const LEAST_DETAIL = 0.3;
const STILL_MS = 250; // after which the last picture is drawn in full

export class Stage {
    constructor(scene, state, panes, truths, element) {
        Object.assign(this, { scene, state, panes, truths, element });
        this.stale = true;
        this.drawing = null;
        this.frames = 0;
        this.shown = null; // the last view and what was sorted for it, a pane each
        this.detail = 0.5; // share of a free view's pixels a side, while it moves; quick at first
        this.finished = 0; // when the last picture was
        state.listen(() => this.invalidate());
        new ResizeObserver(() => this.invalidate()).observe(element);
    }

    invalidate() {
        this.stale = true;
    }

    // Called every frame: draws if something changed and the last picture is finished.
    update() {
        if (this.drawing) return;
        if (this.stale) {
            this.adapt(performance.now() - this.finished);
            this.draw(this.detail);
        } else if (this.shown?.detail < 1 && performance.now() - this.finished > STILL_MS) {
            this.draw(1);
        }
    }

    // interval: since the last picture, ms.
    adapt(interval) {
        if (interval > 4 * STILL_MS) return; // it stood still
        if (interval > SLOW_MS) this.detail = Math.max(LEAST_DETAIL, Math.sqrt(SLOW_MS / interval) * this.detail);
        if (interval < FAST_MS) this.detail = Math.min(1, 1.05 * this.detail);
    }

    draw(detail) {
        this.stale = false;
        this.drawing = this.drawn(this.view(detail)).finally(() => {
            this.drawing = null;
            this.finished = performance.now();
        });
        return this.drawing;
    }

    // The newest state as a finished picture, in full.
    async settled() {
        while (this.drawing || this.stale || this.shown?.detail < 1) await (this.drawing ?? this.draw(1));
    }

    async drawn(view) {
        view.truth = view.frame ? await this.truths.image(view.frame) : null;
        const sorted = await Promise.all(this.panes.map((pane) => pane.sort(view, this.scene)));
        this.panes.forEach((pane, i) => {
            pane.renderer.draw(view, sorted[i], this.scene);
        });
        this.shown = { view, sorted, detail: view.detail };
        ++this.frames;
    }

    // The view of the present state. At a data set's camera it has exactly that camera's pixels.
    view(detail) {
        const { state, scene } = this;
        const common = {
            colourBy: state.colourBy,
            compare: state.compare,
            wipe: state.wipe,
            background: state.background ?? scene.background,
            ownBackground: state.background !== null,
            detail: state.camera === null ? detail : 1,
        };
        if (state.camera !== null) {
            const intrinsics = scene.cameras[state.camera];
            const frame = state.compare === "render" ? null : this.truths.nearest(state.camera, state.time);
            const camera = cameraOf(poseOf(intrinsics.world_to_cam), intrinsics);
            return { ...common, camera, frame, time: frame ? frame.time : state.time, dilation: scene.dilation };
        }
        const { width, height } = this.paneSize(detail);
        const window = fitted(scene.cameras[scene.reference], width, height);
        const camera = cameraOf(state.pose, window);
        // Trained Gaussians are as wide as the training images' pixels: enlarged, so are they.
        const dilation = scene.dilation * Math.max(1, window.scale) ** 2;
        return { ...common, camera, frame: null, time: state.time, dilation };
    }

    paneSize(detail) {
        const box = this.panes[0].renderer.canvas.parentElement.getBoundingClientRect();
        const [wide, high] = [Math.max(1, box.width), Math.max(1, box.height)];
        const density = Math.min(window.devicePixelRatio || 1, Math.sqrt(MOST_PIXELS / (wide * high))) * detail;
        return { width: Math.max(1, Math.round(wide * density)), height: Math.max(1, Math.round(high * density)) };
    }

    // The picture of any camera { width, height, fx, fy, cx, cy, world_to_cam } at a time, as RGBA from the upper left.
    async picture(camera, time, index = 0) {
        while (this.drawing) await this.drawing;
        const pane = this.panes[index];
        const { dilation, background } = this.scene;
        const plain = { colourBy: "colour", compare: "render", background, ownBackground: false, truth: null };
        const view = { ...plain, camera: cameraOf(poseOf(camera.world_to_cam), camera), time, dilation, wipe: 1 };
        this.drawing = pane.sort(view, this.scene).then((sorted) => {
            pane.renderer.draw(view, sorted, this.scene);
            const { gl } = pane.renderer;
            const pixels = new Uint8Array(4 * camera.width * camera.height);
            gl.readPixels(0, 0, camera.width, camera.height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
            this.drawing = null;
            this.stale = true;
            return flipped(pixels, 4 * camera.width);
        });
        return this.drawing;
    }
}

function flipped(pixels, stride) {
    const rows = pixels.length / stride;
    const upright = new Uint8Array(pixels.length);
    for (let row = 0; row < rows; ++row)
        upright.set(pixels.subarray(row * stride, (row + 1) * stride), (rows - 1 - row) * stride);
    return upright;
}
