// Puts the finished 3-D picture into egui's own pass.

@group(0) @binding(0) var picture: texture_2d<f32>;
@group(0) @binding(1) var picture_sampler: sampler;

struct CopyOut {
    @builtin(position) clip: vec4<f32>,
    @location(0) uv: vec2<f32>,
}

// One triangle that covers the viewport.
@vertex
fn vs_copy(@builtin(vertex_index) index: u32) -> CopyOut {
    let uv = vec2<f32>(f32((index << 1u) & 2u), f32(index & 2u));
    var out: CopyOut;
    out.clip = vec4<f32>(uv.x * 2.0 - 1.0, 1.0 - uv.y * 2.0, 0.0, 1.0);
    out.uv = uv;
    return out;
}

@fragment
fn fs_copy_encoded(in: CopyOut) -> @location(0) vec4<f32> {
    return textureSample(picture, picture_sampler, in.uv);
}

// For targets that encode by themselves.
@fragment
fn fs_copy_linear(in: CopyOut) -> @location(0) vec4<f32> {
    let color = textureSample(picture, picture_sampler, in.uv);
    let low = color.rgb / 12.92;
    let high = pow((color.rgb + 0.055) / 1.055, vec3<f32>(2.4));
    return vec4<f32>(select(high, low, color.rgb <= vec3<f32>(0.04045)), color.a);
}
