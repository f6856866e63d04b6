#version 300 es
// The corners of a Gaussian on the screen: the parallelogram around the ellipse in which alpha is at least 1/255.
precision highp float;
precision highp int;
precision highp sampler2D;

uniform sampler2D place, shape, colour;  // of preprocess.frag
uniform int count;
uniform vec2 size;  // pixels

flat out vec4 rgbOpacity;
out vec2 deviation;  // from the mean, in standard deviations along the sheared axes

const float minAlpha = MIN_ALPHA;

void main() {
    int slot = count - 1 - gl_InstanceID, width = textureSize(place, 0).x;  // farthest first
    ivec2 texel = ivec2(slot % width, slot / width);
    vec4 at = texelFetch(place, texel, 0), axes = texelFetch(shape, texel, 0);
    gl_Position = vec4(2.0, 2.0, 0.0, 1.0);  // off the screen
    float reach2 = 2.0 * log(at.w / minAlpha);
    if (!(reach2 > 0.0)) return;
    rgbOpacity = vec4(texelFetch(colour, texel, 0).rgb, at.w);
    deviation = (vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0) * sqrt(reach2);
    vec2 uv = deviation * axes.xy;
    vec2 pixel = at.xy + vec2(uv.x - at.z * uv.y, uv.y);  // u = dx + shear · dy
    gl_Position = vec4(2.0 * pixel.x / size.x - 1.0, 1.0 - 2.0 * pixel.y / size.y, 0.0, 1.0);
}
