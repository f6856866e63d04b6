// One model on the page: a canvas, its renderer, and the worker that sorts for it.

import { dot } from "./camera.js";
import { Renderer, slotsFor } from "./renderer.js";
import { displacedAlong } from "./trajectories.js";

// A figure with a canvas and a caption, at the end of `parent`.
export function figureOn(parent, caption) {
    const element = document.createElement("figure");
    element.className = "pane";
    element.innerHTML = "<canvas></canvas><figcaption></figcaption>";
    element.lastChild.textContent = caption;
    parent.append(element);
    return element;
}

export class Pane {
    constructor(element, label, shaders, workerUrl) {
        Object.assign(this, { element, label });
        this.renderer = new Renderer(element.firstChild, shaders);
        this.worker = new Worker(workerUrl);
        this.worker.onmessage = ({ data }) => this.received(data);
        this.waiting = null;
        this.order = null;
    }

    setModel(model) {
        const { mean, velocity, meanT, lifetime } = model.motion;
        this.renderer.setModel(model);
        this.order = new Uint32Array(slotsFor(model.header.count));
        const weights = model.shared?.weights;
        this.worker.postMessage({ gaussians: { mean, velocity, meanT, lifetime, weights } });
    }

    get model() {
        return this.renderer.model;
    }

    // The Gaussians in view, nearest first; a promise. One at a time.
    sort({ camera, time }, scene) {
        const forward = camera.rotation.slice(6, 9);
        const offset = -dot(forward, camera.position);
        const order = this.order;
        const { shared } = this.model;
        const along = shared ? displacedAlong(shared, time, forward) : [];
        this.worker.postMessage({ time, forward, offset, along, near: scene.near, order }, [order.buffer]);
        return new Promise((resolve) => {
            this.waiting = resolve;
        });
    }

    received(sorted) {
        this.order = sorted.order;
        this.waiting(sorted);
    }
}
