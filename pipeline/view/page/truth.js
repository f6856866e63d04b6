// The ground truth of the data set's views: which image belongs to a camera at a time.

export class Truths {
    constructor(cameras, images, bytes) {
        this.cameras = cameras;
        this.images = images;
        this.bytes = bytes;
        this.decoded = new Map(); // the latest few: a film has many
    }

    has(camera) {
        return this.cameras[camera].frames.some((frame) => frame.truth !== null);
    }

    // The frame of a camera with an image that is nearest to `time`; null without any.
    nearest(camera, time) {
        let best = null;
        for (const frame of this.cameras[camera].frames)
            if (frame.truth !== null && (!best || Math.abs(frame.time - time) < Math.abs(best.time - time)))
                best = frame;
        return best;
    }

    // An ImageBitmap; a promise.
    image(frame) {
        if (!this.decoded.has(frame.truth)) {
            if (this.decoded.size >= 32) this.forgetFirst();
            const { offset, size } = this.images[frame.truth];
            const blob = new Blob([this.bytes.subarray(offset, offset + size)], { type: "image/webp" });
            this.decoded.set(frame.truth, createImageBitmap(blob, { colorSpaceConversion: "none" }));
        }
        return this.decoded.get(frame.truth);
    }

    forgetFirst() {
        const [key, promise] = this.decoded.entries().next().value;
        this.decoded.delete(key);
        promise.then((image) => image.close());
    }
}
