// The 3-D view of the hand. Colours are linear here and leave encoded with gamma, as egui's target wants them.

struct Globals {
    clip_from_world: mat4x4<f32>,
    eye: vec4<f32>,
    // Toward the lamp; w: its strength.
    lamp: vec4<f32>,
    sky: vec4<f32>,
    ground: vec4<f32>,
    // Ring around what is picked.
    mark: vec4<f32>,
    grid_color: vec4<f32>,
    // Middle of the grid (x, y), radius, distance between lines; m.
    grid: vec4<f32>,
}

@group(0) @binding(0) var<uniform> globals: Globals;

fn encoded(linear: vec3<f32>) -> vec3<f32> {
    // IEC 61966-2-1 (sRGB).
    let low = linear * 12.92;
    let high = 1.055 * pow(max(linear, vec3<f32>(0.0)), vec3<f32>(1.0 / 2.4)) - 0.055;
    return select(high, low, linear <= vec3<f32>(0.0031308));
}

struct SolidIn {
    @location(0) position: vec3<f32>,
    @location(1) normal: vec3<f32>,
    @location(2) color: vec4<f32>,
    // Rows of the 3 x 4 matrix from the mesh to the world: rotation, uniform scale, translation.
    @location(3) row0: vec4<f32>,
    @location(4) row1: vec4<f32>,
    @location(5) row2: vec4<f32>,
    @location(6) tint: vec4<f32>,
    // x: share of the colour that light does not change; y: strength of the ring.
    @location(7) look: vec2<f32>,
}

struct SolidOut {
    @builtin(position) clip: vec4<f32>,
    @location(0) world: vec3<f32>,
    @location(1) normal: vec3<f32>,
    @location(2) color: vec4<f32>,
    @location(3) look: vec2<f32>,
}

@vertex
fn vs_solid(in: SolidIn) -> SolidOut {
    let local = vec4<f32>(in.position, 1.0);
    let world = vec3<f32>(dot(in.row0, local), dot(in.row1, local), dot(in.row2, local));
    var out: SolidOut;
    out.clip = globals.clip_from_world * vec4<f32>(world, 1.0);
    out.world = world;
    out.normal = vec3<f32>(dot(in.row0.xyz, in.normal), dot(in.row1.xyz, in.normal), dot(in.row2.xyz, in.normal));
    out.color = in.color * in.tint;
    out.look = in.look;
    return out;
}

@fragment
fn fs_solid(in: SolidOut) -> @location(0) vec4<f32> {
    let normal = normalize(in.normal);
    let to_eye = normalize(globals.eye.xyz - in.world);
    let facing = clamp(dot(normal, to_eye), 0.0, 1.0);
    let hemisphere = mix(globals.ground.rgb, globals.sky.rgb, 0.5 + 0.5 * normal.z);
    let lamp = max(dot(normal, globals.lamp.xyz), 0.0) * globals.lamp.w;
    // A little light from the eye, so that what is looked at from below is not lost in the dark.
    let light = hemisphere + vec3<f32>(lamp) + vec3<f32>(0.28 * facing);
    let halfway = normalize(globals.lamp.xyz + to_eye);
    let gloss = pow(max(dot(normal, halfway), 0.0), 40.0) * 0.10 * globals.lamp.w;
    let lit = in.color.rgb * light + vec3<f32>(gloss);
    var rgb = mix(lit, in.color.rgb, in.look.x);
    rgb = mix(rgb, globals.mark.rgb, in.look.y * smoothstep(0.35, 0.6, 1.0 - facing));
    // Glass shows its rim.
    let rim = pow(1.0 - facing, 3.0);
    let alpha = mix(in.color.a, 1.0, rim * 0.7);
    return vec4<f32>(encoded(min(rgb, vec3<f32>(1.0))) * alpha, alpha);
}

struct GridOut {
    @builtin(position) clip: vec4<f32>,
    @location(0) plane: vec2<f32>,
}

@vertex
fn vs_grid(@builtin(vertex_index) index: u32) -> GridOut {
    var square = array<vec2<f32>, 6>(
        vec2<f32>(-1.0, -1.0), vec2<f32>(1.0, -1.0), vec2<f32>(1.0, 1.0),
        vec2<f32>(-1.0, -1.0), vec2<f32>(1.0, 1.0), vec2<f32>(-1.0, 1.0),
    );
    let plane = globals.grid.xy + square[index] * globals.grid.z;
    var out: GridOut;
    out.clip = globals.clip_from_world * vec4<f32>(plane, 0.0, 1.0);
    out.plane = plane;
    return out;
}

fn line_share(plane: vec2<f32>, spacing: f32) -> f32 {
    let cell = plane / spacing;
    let width = fwidth(cell);
    let distance = abs(fract(cell - 0.5) - 0.5) / max(width, vec2<f32>(1e-6));
    let line = clamp(1.2 - distance, vec2<f32>(0.0), vec2<f32>(1.0));
    // Lines closer than a few pixels would be noise.
    let sparse = clamp(1.0 - width * 3.0, vec2<f32>(0.0), vec2<f32>(1.0));
    return max(line.x * sparse.x, line.y * sparse.y);
}

@fragment
fn fs_grid(in: GridOut) -> @location(0) vec4<f32> {
    let away = length(in.plane - globals.grid.xy) / globals.grid.z;
    let fade = clamp(1.0 - away, 0.0, 1.0);
    let lines = max(line_share(in.plane, globals.grid.w) * 0.55, line_share(in.plane, globals.grid.w * 5.0));
    let alpha = lines * fade * fade * globals.grid_color.a;
    return vec4<f32>(encoded(globals.grid_color.rgb) * alpha, alpha);
}
