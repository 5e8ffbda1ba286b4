//! Paints egui's triangles on the CPU, with the same bits on every computer: pictures can be compared without a graphics
//! card and its driver. What the page draws on the card itself, the 3-D views, stays empty.

use std::collections::HashMap;

use egui::{
    Color32, ColorImage, FullOutput, ImageData, Pos2, Rect, TextureFilter, TextureId, TexturesDelta,
    epaint::{ClippedPrimitive, Mesh, Primitive, Vertex},
};
use egui_kittest::TestRenderer;
use image::RgbaImage;

/// Steps of a pixel in which corners of triangles are placed.
const SUBPIXELS: f32 = 256.0;

/// The textures that egui has made so far.
#[derive(Default)]
pub struct Raster {
    textures: HashMap<TextureId, Texture>,
}

struct Texture {
    image: ColorImage,
    is_smooth: bool,
}

impl TestRenderer for Raster {
    fn handle_delta(&mut self, delta: &mut TexturesDelta) {
        for (id, deltas) in delta.set.drain() {
            for delta in deltas {
                let ImageData::Color(image) = delta.image;
                match (delta.pos, self.textures.get_mut(&id)) {
                    (Some(pos), Some(texture)) => texture.patch(pos, &image),
                    _ => {
                        let is_smooth = delta.options.magnification == TextureFilter::Linear;
                        self.textures.insert(id, Texture { image: (*image).clone(), is_smooth });
                    }
                }
            }
        }
        for id in delta.free.drain() {
            self.textures.remove(&id);
        }
    }

    fn render(&mut self, ctx: &egui::Context, output: &FullOutput) -> Result<RgbaImage, String> {
        let pixels_per_point = ctx.pixels_per_point();
        let size = ctx.content_rect().size() * pixels_per_point;
        // As the page has its canvas cleared.
        let ground = colour(ctx.global_style().visuals.panel_fill);
        let mut canvas = Canvas::new(size.x.round() as usize, size.y.round() as usize, ground);
        for ClippedPrimitive { clip_rect, primitive } in
            ctx.tessellate(output.shapes.clone(), pixels_per_point)
        {
            let Primitive::Mesh(mesh) = primitive else { continue };
            if let Some(texture) = self.textures.get(&mesh.texture_id) {
                canvas.paint(&mesh, clip_rect * pixels_per_point, texture, pixels_per_point);
            }
        }
        let pixels = canvas.pixels.iter().flat_map(|[r, g, b, _]| [*r, *g, *b, 1.0].map(to_byte)).collect();
        RgbaImage::from_raw(canvas.width as u32, canvas.height as u32, pixels)
            .ok_or_else(|| "the picture has another size than its pixels".to_owned())
    }
}

fn to_byte(value: f32) -> u8 {
    (value * 255.0).round().clamp(0.0, 255.0) as u8
}

/// Colours with alpha multiplied in, as egui's are.
type Colour = [f32; 4];

fn colour(colour: Color32) -> Colour {
    colour.to_array().map(|value| f32::from(value) / 255.0)
}

impl Texture {
    fn patch(&mut self, [left, top]: [usize; 2], patch: &ColorImage) {
        let width = self.image.size[0];
        for (y, row) in patch.pixels.chunks(patch.size[0]).enumerate() {
            let at = (top + y) * width + left;
            self.image.pixels[at..at + row.len()].copy_from_slice(row);
        }
    }

    fn texel(&self, x: i64, y: i64) -> Colour {
        let [width, height] = self.image.size;
        let (x, y) = (x.clamp(0, width as i64 - 1) as usize, y.clamp(0, height as i64 - 1) as usize);
        colour(self.image.pixels[y * width + x])
    }

    fn sample(&self, uv: Pos2) -> Colour {
        let [width, height] = self.image.size.map(|side| side as f32);
        if !self.is_smooth {
            return self.texel((uv.x * width).floor() as i64, (uv.y * height).floor() as i64);
        }
        let (x, y) = (uv.x * width - 0.5, uv.y * height - 0.5);
        let (left, top) = (x.floor(), y.floor());
        let (right_share, bottom_share) = (x - left, y - top);
        let texel = |dx: i64, dy: i64| self.texel(left as i64 + dx, top as i64 + dy);
        let upper = mix(texel(0, 0), texel(1, 0), right_share);
        let lower = mix(texel(0, 1), texel(1, 1), right_share);
        mix(upper, lower, bottom_share)
    }
}

fn mix(from: Colour, to: Colour, share: f32) -> Colour {
    std::array::from_fn(|idx| from[idx] + (to[idx] - from[idx]) * share)
}

struct Canvas {
    width: usize,
    height: usize,
    pixels: Vec<Colour>,
}

impl Canvas {
    fn new(width: usize, height: usize, ground: Colour) -> Self {
        Self { width, height, pixels: vec![ground; width * height] }
    }

    fn paint(&mut self, mesh: &Mesh, clip: Rect, texture: &Texture, pixels_per_point: f32) {
        let clip = [
            (clip.left().round().max(0.0) as usize).min(self.width),
            (clip.top().round().max(0.0) as usize).min(self.height),
            (clip.right().round().max(0.0) as usize).min(self.width),
            (clip.bottom().round().max(0.0) as usize).min(self.height),
        ];
        for corners in mesh.indices.chunks_exact(3) {
            let corners = [corners[0], corners[1], corners[2]].map(|idx| mesh.vertices[idx as usize]);
            self.triangle(corners, clip, texture, pixels_per_point);
        }
    }

    /// Covers the pixels whose middle lies in the triangle; one on an edge belongs to the triangle below or right of it, so
    /// that two that share the edge cover it once.
    fn triangle(
        &mut self,
        mut corners: [Vertex; 3],
        [left, top, right, bottom]: [usize; 4],
        texture: &Texture,
        pixels_per_point: f32,
    ) {
        let place = |vertex: &Vertex| {
            [vertex.pos.x, vertex.pos.y].map(|value| (value * pixels_per_point * SUBPIXELS).round() as i64)
        };
        let twice_area =
            |[a, b, c]: [[i64; 2]; 3]| (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        let mut places = [place(&corners[0]), place(&corners[1]), place(&corners[2])];
        let mut area = twice_area(places);
        if area < 0 {
            corners.swap(1, 2);
            places.swap(1, 2);
            area = -area;
        }
        if area == 0 {
            return;
        }
        let step = SUBPIXELS as i64;
        let range = |axis: usize, low: usize, high: usize| {
            let values = places.map(|place| place[axis]);
            let first = values.iter().min().map_or(0, |value| value.div_euclid(step));
            let last = values.iter().max().map_or(0, |value| value.div_euclid(step) + 1);
            (first.max(low as i64), last.min(high as i64))
        };
        let ((first_x, last_x), (first_y, last_y)) = (range(0, left, right), range(1, top, bottom));
        // Weight of each corner: of the edge opposite to it.
        let edges = [[1, 2], [2, 0], [0, 1]].map(|[from, to]| (places[from], places[to]));
        let is_owned = edges.map(|(from, to)| {
            let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
            dy < 0 || (dy == 0 && dx > 0)
        });
        let colours = corners.map(|corner| colour(corner.color));
        let is_plain = corners.iter().all(|c| c.color == corners[0].color && c.uv == corners[0].uv);
        let plain = is_plain.then(|| multiply(colours[0], texture.sample(corners[0].uv)));
        for y in first_y..last_y {
            for x in first_x..last_x {
                let middle = [x * step + step / 2, y * step + step / 2];
                let weights = edges.map(|(from, to)| twice_area([from, to, middle]));
                let covers = weights
                    .iter()
                    .zip(is_owned)
                    .all(|(&weight, is_owned)| weight > 0 || (weight == 0 && is_owned));
                if !covers {
                    continue;
                }
                let source = plain.unwrap_or_else(|| {
                    let shares = weights.map(|weight| weight as f32 / area as f32);
                    let of = |value: &dyn Fn(usize) -> f32| {
                        (0..3).map(|corner| shares[corner] * value(corner)).sum::<f32>()
                    };
                    let uv = Pos2::new(of(&|at| corners[at].uv.x), of(&|at| corners[at].uv.y));
                    let tint = std::array::from_fn(|channel| of(&|at| colours[at][channel]));
                    multiply(tint, texture.sample(uv))
                });
                let below = &mut self.pixels[y as usize * self.width + x as usize];
                *below = std::array::from_fn(|idx| source[idx] + below[idx] * (1.0 - source[3]));
            }
        }
    }
}

fn multiply(a: Colour, b: Colour) -> Colour {
    std::array::from_fn(|idx| a[idx] * b[idx])
}
