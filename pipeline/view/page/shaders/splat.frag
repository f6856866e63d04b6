#version 300 es
// Alpha of a Gaussian at a pixel, by the kernel's rules: at most 0.99, none below 1/255.
precision highp float;

flat in vec4 rgbOpacity;
in vec2 deviation;
out vec4 blended;  // multiplied by alpha

const float minAlpha = MIN_ALPHA, maxAlpha = MAX_ALPHA;

void main() {
    float alpha = min(maxAlpha, rgbOpacity.a * exp(-0.5 * dot(deviation, deviation)));
    if (alpha < minAlpha) discard;
    blended = vec4(rgbOpacity.rgb * alpha, alpha);
}
