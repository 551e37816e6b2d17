#version 430
// The image of binned echoes: eq. 1 and 2 of Cerqueira et al. 2017 and receiver noise, with the random
// numbers of sonar/draws.py: Philox 4x32-10 counted by pair of bins and beam, tables of quantiles.
layout(local_size_x = 16, local_size_y = 16) in;
layout(std430, binding = 0) readonly buffer Echo { uint echo_sum[]; };
layout(std430, binding = 1) readonly buffer Coverage { uint coverage[]; };
layout(std430, binding = 2) readonly buffer Tables { float tables[]; };  // of speckle, of noise
layout(std430, binding = 3) writeonly buffer Image { float image[]; };
uniform int beams;
uniform int bins;
uniform int cells;     // of a table; a row has one entry more, and a table three rows
uniform uint key_low;
uniform uint key_high;
uniform float unit;
uniform float least;
uniform float noise;

uvec4 philox(uvec4 c, uvec2 k) {
    for (int n = 0; n < 10; ++n) {
        uint p_high, p_low, q_high, q_low;
        umulExtended(0xD2511F53u, c.x, p_high, p_low);
        umulExtended(0xCD9E8D57u, c.z, q_high, q_low);
        c = uvec4(q_high ^ c.y ^ k.x, q_low, p_high ^ c.w ^ k.y, p_low);
        k += uvec2(0x9E3779B9u, 0xBB67AE85u);
    }
    return c;
}

float variate(int table, uint word) {
    int row = 0, cell = int(word >> 20);
    float part = float(word & 0xFFFFFu) / 1048576.0;
    if (cell == 0 || cell == cells - 1) {
        row = cell == 0 ? 1 : 2;
        cell = int((word >> 8) & 0xFFFu);
        part = float(word & 0xFFu) / 256.0;
    }
    int at = (3 * table + row) * (cells + 1) + cell;
    return tables[at] + part * (tables[at + 1] - tables[at]);
}

void main() {
    int pair = int(gl_GlobalInvocationID.x), beam = int(gl_GlobalInvocationID.y);
    if (2 * pair >= bins || beam >= beams) return;
    uvec4 words = philox(uvec4(pair, beam, 0, 0), uvec2(key_low, key_high));
    for (int half_ = 0; half_ < 2 && 2 * pair + half_ < bins; ++half_) {
        int at = beam * bins + 2 * pair + half_;
        float value = float(echo_sum[at]) / unit / max(float(coverage[at]) / unit, least);
        value *= variate(0, words[2 * half_]);
        value += noise * variate(1, words[2 * half_ + 1]);
        image[at] = clamp(value, 0.0, 1.0);
    }
}
