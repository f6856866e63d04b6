// Draws one model into one canvas, in the kernel's stages: preprocess, (sort, in the worker), blend, compose.

import { contextOf, dataTexture, filtered, Program, targetOf } from "./textures.js";
import { tableAt } from "./trajectories.js";

export const COLOUR_BY = ["colour", "lifetime", "speed", "depth"];
export const COMPARE = ["render", "truth", "wipe", "difference"];

const SLOTS = 1024; // columns of textures with a texel a Gaussian in view
const WIDE = 4096; // columns of the model's own textures

export class Renderer {
    constructor(canvas, shaders) {
        const gl = contextOf(canvas);
        this.canvas = canvas;
        this.gl = gl;
        this.preprocess = new Program(gl, shaders.cover, shaders.preprocess);
        this.splat = new Program(gl, shaders.splatCorners, shaders.splat);
        this.compose = new Program(gl, shaders.cover, shaders.compose);
        this.nothing = dataTexture(gl, [gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE], 1, 4, new Uint8Array(4));
        this.truth = gl.createTexture();
        this.truthShown = null;
        this.blended = null;
        this.owned = [];
    }

    // Replaces the model that is drawn; the textures of the one before are freed.
    setModel(model) {
        const gl = this.gl;
        for (const free of this.owned) free();
        this.owned = [];
        const own = (texture) => {
            this.owned.push(() => gl.deleteTexture(texture));
            return texture;
        };
        const { count } = model.header;
        const rows = rowsFor(count);
        const float = [gl.RGBA32F, gl.RGBA, gl.FLOAT];
        this.model = model;
        this.geometry = own(dataTexture(gl, float, WIDE, 4, model.geometry));
        this.sh = own(dataTexture(gl, [gl.RGBA16I, gl.RGBA_INTEGER, gl.SHORT], WIDE, 4, model.sh));
        this.weights = this.table = this.nothing;
        if (model.shared) {
            this.weights = own(dataTexture(gl, [gl.R32F, gl.RED, gl.FLOAT], WIDE, 1, model.shared.weights));
            this.table = own(dataTexture(gl, float, 3, 4, null, model.shared.count));
        }
        const order = [gl.R32UI, gl.RED_INTEGER, gl.UNSIGNED_INT];
        this.order = own(dataTexture(gl, order, SLOTS, 1, null, rows));
        this.splats = Array.from({ length: 3 }, () => own(dataTexture(gl, float, SLOTS, 4, null, rows)));
        const target = targetOf(gl, this.splats);
        this.splatTarget = target;
        this.owned.push(() => gl.deleteFramebuffer(target));
        this.environment = null;
        if (model.environment) {
            const { width, pixels } = model.environment;
            this.environment = own(dataTexture(gl, [gl.RGBA16F, gl.RGBA, gl.FLOAT], width, 4, pixels));
            filtered(gl, gl.LINEAR, gl.REPEAT);
        }
    }

    // view: { camera, time, dilation, colourBy, compare, wipe, background, truth }; sorted: what the worker sent for it.
    draw(view, sorted, scene) {
        const { gl, model } = this;
        const { camera } = view;
        this.resize(camera.width, camera.height);
        const size = [camera.width, camera.height];
        const pinhole = { size, focal: [camera.fx, camera.fy], centre: [camera.cx, camera.cy] };
        const rotation = camera.rotation; // row-major world to camera, which is column-major camera to world
        const range = view.colourBy === "depth" ? sorted.depths : (model.ranges[view.colourBy] ?? [0, 1]);
        const colourBy = COLOUR_BY.indexOf(view.colourBy);

        const rows = rowsFor(sorted.count);
        gl.bindTexture(gl.TEXTURE_2D, this.order);
        gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, SLOTS, rows, gl.RED_INTEGER, gl.UNSIGNED_INT, sorted.order);
        if (model.shared) {
            const table = tableAt(model.shared, view.time);
            gl.bindTexture(gl.TEXTURE_2D, this.table);
            gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, 3, model.shared.count, gl.RGBA, gl.FLOAT, table);
        }
        gl.bindFramebuffer(gl.FRAMEBUFFER, this.splatTarget);
        gl.viewport(0, 0, SLOTS, rows);
        gl.disable(gl.BLEND);
        this.preprocess.use({
            ...pinhole,
            order: this.order,
            geometry: this.geometry,
            sh: this.sh,
            weights: this.weights,
            table: this.table,
            trajectories: model.shared?.count ?? 0,
            count: sorted.count,
            shStep: model.shStep,
            coefficients: model.header.coefficients,
            orders: model.header.orders,
            time: view.time,
            duration: scene.duration,
            worldToCam: transposed(rotation),
            position: camera.position,
            dilation: view.dilation,
            colourBy,
            range,
        });
        gl.drawArrays(gl.TRIANGLES, 0, 3);

        gl.bindFramebuffer(gl.FRAMEBUFFER, this.blendTarget);
        gl.viewport(0, 0, ...size);
        gl.clearColor(0, 0, 0, 0);
        gl.clear(gl.COLOR_BUFFER_BIT);
        gl.enable(gl.BLEND);
        gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
        const [place, shape, colour] = this.splats;
        this.splat.use({ place, shape, colour, count: sorted.count, size });
        gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, sorted.count);

        gl.bindFramebuffer(gl.FRAMEBUFFER, null);
        gl.disable(gl.BLEND);
        const compare = view.truth ? Math.max(0, COMPARE.indexOf(view.compare)) : 0;
        if (compare) this.uploadTruth(view.truth);
        this.compose.use({
            ...pinhole,
            blended: this.blended,
            environment: this.environment ?? this.nothing,
            truth: this.truth,
            hasEnvironment: this.environment !== null && colourBy === 0 && !view.ownBackground,
            background: colourBy === 0 || view.ownBackground ? view.background : [0, 0, 0],
            camToWorld: rotation,
            isDepth: colourBy === 3,
            range,
            compare,
            wipe: view.wipe,
        });
        gl.drawArrays(gl.TRIANGLES, 0, 3);
    }

    uploadTruth(image) {
        const gl = this.gl;
        if (this.truthShown === image) return;
        gl.bindTexture(gl.TEXTURE_2D, this.truth);
        gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, image);
        filtered(gl, gl.LINEAR);
        this.truthShown = image;
    }

    // Half floats: their rounding is 60 dB below the picture.
    resize(width, height) {
        const gl = this.gl;
        if (this.blended && this.canvas.width === width && this.canvas.height === height) return;
        this.canvas.width = width;
        this.canvas.height = height;
        gl.deleteTexture(this.blended);
        gl.deleteFramebuffer(this.blendTarget ?? null);
        this.blended = dataTexture(gl, [gl.RGBA16F, gl.RGBA, gl.HALF_FLOAT], width, 4, null, height);
        this.blendTarget = targetOf(gl, [this.blended]);
    }
}

const rowsFor = (count) => Math.max(1, Math.ceil(count / SLOTS));

// Of whole rows, which an order must be long enough to fill.
export const slotsFor = (count) => SLOTS * rowsFor(count);

function transposed(m) {
    return [m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]];
}
