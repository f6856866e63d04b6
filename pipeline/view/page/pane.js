// One model on the page: a canvas, its renderer, and the worker that sorts for it.

import { Renderer } from "./renderer.js";

export class Pane {
    constructor(canvas, label, shaders, workerUrl) {
        this.label = label;
        this.renderer = new Renderer(canvas, shaders);
        this.worker = new Worker(workerUrl);
        this.worker.onmessage = ({ data }) => this.received(data);
        this.waiting = null;
        this.order = null;
    }

    setModel(model) {
        const { mean, velocity, meanT, lifetime } = model.motion;
        this.renderer.setModel(model);
        this.order = new Uint32Array(Renderer.slots(model.header.count));
        this.worker.postMessage({ gaussians: { mean, velocity, meanT, lifetime } });
    }

    get model() {
        return this.renderer.model;
    }

    // The Gaussians in view, nearest first; a promise. One at a time.
    sort({ camera, time }, scene) {
        const forward = camera.rotation.slice(6, 9);
        const offset = -(
            forward[0] * camera.position[0] +
            forward[1] * camera.position[1] +
            forward[2] * camera.position[2]
        );
        const order = this.order;
        this.worker.postMessage({ time, forward, offset, near: scene.near, order }, [order.buffer]);
        return new Promise((resolve) => {
            this.waiting = resolve;
        });
    }

    received(sorted) {
        this.order = sorted.order;
        this.waiting(sorted);
    }

    draw(view, sorted, scene) {
        this.renderer.draw(view, sorted, scene);
    }
}
