#version 430
// Splits the image into beams by the angle channel and bins each by distance.  Sums are kept as
// integers, since their order must not matter.
layout(local_size_x = 16, local_size_y = 16) in;
layout(binding = 0) uniform sampler2D channels;
layout(binding = 1) uniform sampler2D patch_of;
layout(std430, binding = 0) buffer Echo { uint echo_sum[]; };
layout(std430, binding = 1) buffer Coverage { uint coverage[]; };
uniform int beams;
uniform int bins;
uniform float half_azimuth;
uniform float beam_rad;
uniform float range_min_m;
uniform float bin_m;
uniform float unit;

// Share of a trapezium, the sum of two even spreads, at less than x from its middle.
float share_below(float x, float rise, float skew) {
    float wide = max(rise, skew), narrow = min(rise, skew);
    float reach = 0.5 * (wide + narrow), level = 0.5 * (wide - narrow), off = abs(x);
    float above = off >= reach ? 0.0
        : off <= level ? 0.5 - off / wide
        : (reach - off) * (reach - off) / (2.0 * wide * narrow);
    return x < 0.0 ? above : 1.0 - above;
}

void main() {
    ivec2 at = ivec2(gl_GlobalInvocationID.xy);
    if (any(greaterThanEqual(at, textureSize(channels, 0)))) return;
    vec4 c = texelFetch(channels, at, 0);
    if (c.w <= 0.0) return;
    vec2 spread = texelFetch(patch_of, at, 0).xy / bin_m;
    int beam = clamp(int(floor((half_azimuth - c.z) / beam_rad)), 0, beams - 1);
    float middle = (c.y - range_min_m) / bin_m;
    float reach = 0.5 * (spread.x + spread.y);
    int first = int(floor(middle - reach)), last = int(floor(middle + reach));
    if (last < 0 || first >= bins) return;
    bool whole = first == last;
    float below = first >= 0 ? 0.0 : share_below(-middle, spread.x, spread.y);
    for (int bin = max(first, 0); bin <= min(last, bins - 1); ++bin) {
        float up_to = whole ? 1.0 : share_below(float(bin + 1) - middle, spread.x, spread.y);
        float share = c.w * (up_to - below) * unit;
        atomicAdd(echo_sum[beam * bins + bin], uint(share * c.x + 0.5));
        atomicAdd(coverage[beam * bins + bin], uint(share + 0.5));
        below = up_to;
    }
}
