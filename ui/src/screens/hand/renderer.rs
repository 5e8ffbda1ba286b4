//! The graphics card's side of the 3-D view: the scene goes into a picture of its own, with depth and anti-aliasing, and
//! the picture into egui's pass, which has neither.
//!
//! Works on WebGL2: no storage buffers, no first instance, no base vertex.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use egui::PaintCallbackInfo;
use egui_wgpu::{CallbackResources, CallbackTrait, ScreenDescriptor};

use super::{
    mesh::Vertex,
    scene::{Geometry, Instance},
};
use crate::surface::Surface;

const PICTURE_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;
const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth24Plus;

/// Samples a pixel: the four that WebGL2 and WebGPU both promise for these formats, or one where a processor would paint
/// them all.
fn sample_count(surface: Surface) -> u32 {
    if surface.by_processor { 1 } else { 4 }
}

/// A picture of the scene, ready to be drawn.
pub(super) struct ScenePaint {
    /// What it shows. The same one again is not drawn again.
    pub drawing: Arc<Drawing>,
    /// Its size on the page, points.
    pub size_points: egui::Vec2,
    /// What egui paints on.
    pub surface: Surface,
}

/// A scene, and how finely it is drawn.
#[derive(Debug)]
pub(super) struct Drawing {
    /// What is shown.
    pub scene: Scene,
    /// Pixels of the picture for one of the page, along each edge; at most 1.
    pub share: f32,
}

/// What a picture shows.
#[derive(Debug)]
pub(super) struct Scene {
    /// Meshes; uploaded when they are not those of the picture before.
    pub geometry: Arc<Geometry>,
    /// What to draw. Instances of one mesh that follow each other are drawn together; translucent ones go last.
    pub instances: Vec<Instance>,
    /// Camera, lights and colours.
    pub globals: Globals,
    /// Behind everything, encoded RGBA.
    pub background: [f64; 4],
}

impl PartialEq for Scene {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.geometry, &other.geometry)
            && self.globals == other.globals
            && self.background == other.background
            && self.instances == other.instances
    }
}

/// What the whole picture shares; the layout of the shader's uniform.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub(super) struct Globals {
    /// Column-major.
    pub clip_from_world: [[f32; 4]; 4],
    /// The eye's position.
    pub eye: [f32; 4],
    /// Toward the lamp, and its strength.
    pub lamp: [f32; 4],
    /// Light from above.
    pub sky: [f32; 4],
    /// Light from below.
    pub ground: [f32; 4],
    /// Ring around what is picked.
    pub mark: [f32; 4],
    /// Lines of the grid.
    pub grid_color: [f32; 4],
    /// Middle of the grid (x, y), its radius, distance between lines; m.
    pub grid: [f32; 4],
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct InstanceRaw {
    rows: [[f32; 4]; 3],
    tint: [f32; 4],
    look: [f32; 2],
}

impl From<&Instance> for InstanceRaw {
    fn from(instance: &Instance) -> Self {
        let m = &instance.root_from_mesh;
        Self {
            rows: [0, 1, 2].map(|row| [0, 1, 2, 3].map(|column| m[(row, column)])),
            tint: instance.color,
            look: [instance.unlit, instance.rim],
        }
    }
}

/// Where a mesh lies in the shared buffers.
struct MeshRange {
    vertex_bytes: std::ops::Range<u64>,
    indices: std::ops::Range<u32>,
}

struct GpuGeometry {
    source: Arc<Geometry>,
    vertices: wgpu::Buffer,
    indices: wgpu::Buffer,
    ranges: Vec<MeshRange>,
}

struct Picture {
    size: [u32; 2],
    resolved: wgpu::TextureView,
    /// `None` where a pixel has one sample.
    multisampled: Option<wgpu::TextureView>,
    depth: wgpu::TextureView,
    copy_bindings: wgpu::BindGroup,
}

struct HandRenderer {
    opaque: wgpu::RenderPipeline,
    translucent: wgpu::RenderPipeline,
    grid: wgpu::RenderPipeline,
    copy: wgpu::RenderPipeline,
    copy_layout: wgpu::BindGroupLayout,
    sampler: wgpu::Sampler,
    globals: wgpu::Buffer,
    globals_bindings: wgpu::BindGroup,
    instances: wgpu::Buffer,
    surface: Surface,
    geometry: Option<GpuGeometry>,
    picture: Option<Picture>,
    /// What the picture shows now.
    drawn: Option<Arc<Drawing>>,
}

impl HandRenderer {
    fn new(device: &wgpu::Device, surface: Surface) -> Self {
        let sample_count = sample_count(surface);
        let scene_shader = device.create_shader_module(wgpu::include_wgsl!("scene.wgsl"));
        let copy_shader = device.create_shader_module(wgpu::include_wgsl!("copy.wgsl"));
        let globals = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("hand globals"),
            size: size_of::<Globals>() as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let globals_layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("hand globals"),
            entries: &[wgpu::BindGroupLayoutEntry {
                binding: 0,
                visibility: wgpu::ShaderStages::VERTEX_FRAGMENT,
                ty: wgpu::BindingType::Buffer {
                    ty: wgpu::BufferBindingType::Uniform,
                    has_dynamic_offset: false,
                    min_binding_size: wgpu::BufferSize::new(size_of::<Globals>() as u64),
                },
                count: None,
            }],
        });
        let globals_bindings = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("hand globals"),
            layout: &globals_layout,
            entries: &[wgpu::BindGroupEntry { binding: 0, resource: globals.as_entire_binding() }],
        });
        let copy_layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("hand picture"),
            entries: &[
                wgpu::BindGroupLayoutEntry {
                    binding: 0,
                    visibility: wgpu::ShaderStages::FRAGMENT,
                    ty: wgpu::BindingType::Texture {
                        sample_type: wgpu::TextureSampleType::Float { filterable: true },
                        view_dimension: wgpu::TextureViewDimension::D2,
                        multisampled: false,
                    },
                    count: None,
                },
                wgpu::BindGroupLayoutEntry {
                    binding: 1,
                    visibility: wgpu::ShaderStages::FRAGMENT,
                    ty: wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering),
                    count: None,
                },
            ],
        });
        let scene_pipeline = |label,
                              entries: [&str; 2],
                              buffers: &[Option<wgpu::VertexBufferLayout<'_>>],
                              translucent: bool,
                              culled: bool| {
            let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some(label),
                bind_group_layouts: &[Some(&globals_layout)],
                immediate_size: 0,
            });
            device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some(label),
                layout: Some(&layout),
                vertex: wgpu::VertexState {
                    module: &scene_shader,
                    entry_point: Some(entries[0]),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    buffers,
                },
                primitive: wgpu::PrimitiveState {
                    cull_mode: culled.then_some(wgpu::Face::Back),
                    ..wgpu::PrimitiveState::default()
                },
                depth_stencil: Some(wgpu::DepthStencilState {
                    format: DEPTH_FORMAT,
                    depth_write_enabled: Some(!translucent),
                    depth_compare: Some(wgpu::CompareFunction::LessEqual),
                    stencil: wgpu::StencilState::default(),
                    bias: wgpu::DepthBiasState::default(),
                }),
                multisample: wgpu::MultisampleState {
                    count: sample_count,
                    ..wgpu::MultisampleState::default()
                },
                fragment: Some(wgpu::FragmentState {
                    module: &scene_shader,
                    entry_point: Some(entries[1]),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    targets: &[Some(wgpu::ColorTargetState {
                        format: PICTURE_FORMAT,
                        blend: Some(wgpu::BlendState::PREMULTIPLIED_ALPHA_BLENDING),
                        write_mask: wgpu::ColorWrites::ALL,
                    })],
                }),
                multiview_mask: None,
                cache: None,
            })
        };
        let solid_buffers = [
            Some(wgpu::VertexBufferLayout {
                array_stride: size_of::<Vertex>() as u64,
                step_mode: wgpu::VertexStepMode::Vertex,
                attributes: &wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x3, 2 => Float32x4],
            }),
            Some(wgpu::VertexBufferLayout {
                array_stride: size_of::<InstanceRaw>() as u64,
                step_mode: wgpu::VertexStepMode::Instance,
                attributes: &wgpu::vertex_attr_array![3 => Float32x4, 4 => Float32x4, 5 => Float32x4, 6 => Float32x4, 7 => Float32x2],
            }),
        ];
        let copy_entry = if surface.format.is_srgb() { "fs_copy_linear" } else { "fs_copy_encoded" };
        let copy_pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("hand copy"),
            bind_group_layouts: &[Some(&copy_layout)],
            immediate_size: 0,
        });
        let copy = device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("hand copy"),
            layout: Some(&copy_pipeline_layout),
            vertex: wgpu::VertexState {
                module: &copy_shader,
                entry_point: Some("vs_copy"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: None,
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: &copy_shader,
                entry_point: Some(copy_entry),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                targets: &[Some(surface.format.into())],
            }),
            multiview_mask: None,
            cache: None,
        });
        Self {
            opaque: scene_pipeline("hand solids", ["vs_solid", "fs_solid"], &solid_buffers, false, true),
            translucent: scene_pipeline("hand glass", ["vs_solid", "fs_solid"], &solid_buffers, true, true),
            grid: scene_pipeline("hand grid", ["vs_grid", "fs_grid"], &[], true, false),
            copy,
            copy_layout,
            sampler: device.create_sampler(&wgpu::SamplerDescriptor {
                label: Some("hand picture"),
                mag_filter: wgpu::FilterMode::Linear,
                min_filter: wgpu::FilterMode::Linear,
                ..wgpu::SamplerDescriptor::default()
            }),
            globals,
            globals_bindings,
            instances: instance_buffer(device, 256),
            surface,
            geometry: None,
            picture: None,
            drawn: None,
        }
    }

    fn upload_geometry(&mut self, device: &wgpu::Device, queue: &wgpu::Queue, source: &Arc<Geometry>) {
        if self.geometry.as_ref().is_some_and(|uploaded| Arc::ptr_eq(&uploaded.source, source)) {
            return;
        }
        let mut vertices: Vec<Vertex> = Vec::new();
        let mut indices: Vec<u32> = Vec::new();
        let mut ranges = Vec::new();
        for mesh in &source.meshes {
            let (first_vertex, first_index) = (vertices.len(), indices.len() as u32);
            vertices.extend(&mesh.vertices);
            indices.extend(&mesh.indices);
            let stride = size_of::<Vertex>() as u64;
            ranges.push(MeshRange {
                vertex_bytes: first_vertex as u64 * stride..vertices.len() as u64 * stride,
                indices: first_index..indices.len() as u32,
            });
        }
        let filled = |label, bytes: &[u8], usage| {
            let buffer = device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size: (bytes.len() as u64).max(4),
                usage: usage | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            });
            queue.write_buffer(&buffer, 0, bytes);
            buffer
        };
        self.drawn = None;
        self.geometry = Some(GpuGeometry {
            source: Arc::clone(source),
            vertices: filled("hand vertices", bytemuck::cast_slice(&vertices), wgpu::BufferUsages::VERTEX),
            indices: filled("hand indices", bytemuck::cast_slice(&indices), wgpu::BufferUsages::INDEX),
            ranges,
        });
    }

    fn resize_picture(&mut self, device: &wgpu::Device, size: [u32; 2]) {
        if self.picture.as_ref().is_some_and(|picture| picture.size == size) {
            return;
        }
        let sample_count = sample_count(self.surface);
        let texture = |label, format, sample_count, usage| {
            let texture = device.create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: wgpu::Extent3d { width: size[0], height: size[1], depth_or_array_layers: 1 },
                mip_level_count: 1,
                sample_count,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage,
                view_formats: &[],
            });
            texture.create_view(&wgpu::TextureViewDescriptor::default())
        };
        let attachment = wgpu::TextureUsages::RENDER_ATTACHMENT;
        let resolved =
            texture("hand picture", PICTURE_FORMAT, 1, attachment | wgpu::TextureUsages::TEXTURE_BINDING);
        let copy_bindings = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("hand picture"),
            layout: &self.copy_layout,
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::TextureView(&resolved) },
                wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::Sampler(&self.sampler) },
            ],
        });
        self.drawn = None;
        self.picture = Some(Picture {
            size,
            resolved,
            multisampled: (sample_count > 1)
                .then(|| texture("hand samples", PICTURE_FORMAT, sample_count, attachment)),
            depth: texture("hand depth", DEPTH_FORMAT, sample_count, attachment),
            copy_bindings,
        });
    }

    fn draw(
        &mut self,
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        encoder: &mut wgpu::CommandEncoder,
        drawing: &Arc<Drawing>,
    ) {
        let (Some(geometry), Some(picture)) = (&self.geometry, &self.picture) else { return };
        if self.drawn.as_ref().is_some_and(|drawn| Arc::ptr_eq(drawn, drawing)) {
            // The picture is there already; a processor that draws needs its time for other things.
            return;
        }
        self.drawn = Some(Arc::clone(drawing));
        let scene = &drawing.scene;
        let raw: Vec<InstanceRaw> = scene.instances.iter().map(InstanceRaw::from).collect();
        let bytes: &[u8] = bytemuck::cast_slice(&raw);
        if bytes.len() as u64 > self.instances.size() {
            self.instances = instance_buffer(device, raw.len().next_power_of_two());
        }
        queue.write_buffer(&self.instances, 0, bytes);
        queue.write_buffer(&self.globals, 0, bytemuck::bytes_of(&scene.globals));

        let [r, g, b, a] = scene.background;
        let (view, resolve_target) = match &picture.multisampled {
            Some(multisampled) => (multisampled, Some(&picture.resolved)),
            None => (&picture.resolved, None),
        };
        let store = if resolve_target.is_some() { wgpu::StoreOp::Discard } else { wgpu::StoreOp::Store };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("hand"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view,
                depth_slice: None,
                resolve_target,
                ops: wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color { r, g, b, a }), store },
            })],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &picture.depth,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(1.0),
                    store: wgpu::StoreOp::Discard,
                }),
                stencil_ops: None,
            }),
            timestamp_writes: None,
            occlusion_query_set: None,
            multiview_mask: None,
        });
        pass.set_bind_group(0, &self.globals_bindings, &[]);
        pass.set_index_buffer(geometry.indices.slice(..), wgpu::IndexFormat::Uint32);
        let batches = batches(&scene.instances);
        let draw_batches = |pass: &mut wgpu::RenderPass<'_>, translucent: bool| {
            for batch in batches.iter().filter(|batch| batch.translucent == translucent) {
                let range = &geometry.ranges[batch.mesh];
                if range.indices.is_empty() {
                    continue;
                }
                pass.set_vertex_buffer(0, geometry.vertices.slice(range.vertex_bytes.clone()));
                // WebGL2 has no first instance: the buffer is bound from there on instead.
                let stride = size_of::<InstanceRaw>();
                let first_byte = (batch.instances.start * stride) as u64;
                let end_byte = (batch.instances.end * stride) as u64;
                pass.set_vertex_buffer(1, self.instances.slice(first_byte..end_byte));
                pass.draw_indexed(range.indices.clone(), 0, 0..batch.instances.len() as u32);
            }
        };
        pass.set_pipeline(&self.opaque);
        draw_batches(&mut pass, false);
        pass.set_pipeline(&self.grid);
        pass.draw(0..6, 0..1);
        pass.set_pipeline(&self.translucent);
        draw_batches(&mut pass, true);
    }
}

impl CallbackTrait for ScenePaint {
    fn prepare(
        &self,
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        screen: &ScreenDescriptor,
        encoder: &mut wgpu::CommandEncoder,
        resources: &mut CallbackResources,
    ) -> Vec<wgpu::CommandBuffer> {
        if resources.get::<HandRenderer>().is_none_or(|renderer| renderer.surface != self.surface) {
            resources.insert(HandRenderer::new(device, self.surface));
        }
        if let Some(renderer) = resources.get_mut::<HandRenderer>() {
            let most = device.limits().max_texture_dimension_2d;
            let per_point = screen.pixels_per_point * self.drawing.share;
            let pixels = |points: f32| ((points * per_point).round() as u32).clamp(1, most);
            renderer.upload_geometry(device, queue, &self.drawing.scene.geometry);
            renderer.resize_picture(device, [pixels(self.size_points.x), pixels(self.size_points.y)]);
            renderer.draw(device, queue, encoder, &self.drawing);
        }
        Vec::new()
    }

    fn paint(
        &self,
        _info: PaintCallbackInfo,
        pass: &mut wgpu::RenderPass<'static>,
        resources: &CallbackResources,
    ) {
        if let Some(renderer) = resources.get::<HandRenderer>()
            && let Some(picture) = &renderer.picture
        {
            pass.set_pipeline(&renderer.copy);
            pass.set_bind_group(0, &picture.copy_bindings, &[]);
            pass.draw(0..3, 0..1);
        }
    }
}

/// Instances of one mesh that follow each other.
#[derive(Debug, PartialEq)]
struct Batch {
    mesh: usize,
    translucent: bool,
    instances: std::ops::Range<usize>,
}

fn batches(instances: &[Instance]) -> Vec<Batch> {
    let mut batches: Vec<Batch> = Vec::new();
    for (idx, instance) in instances.iter().enumerate() {
        let translucent = instance.color[3] < 1.0;
        match batches.last_mut() {
            Some(last) if last.mesh == instance.mesh && last.translucent == translucent => {
                last.instances.end = idx + 1;
            }
            _ => batches.push(Batch { mesh: instance.mesh, translucent, instances: idx..idx + 1 }),
        }
    }
    batches
}

fn instance_buffer(device: &wgpu::Device, capacity: usize) -> wgpu::Buffer {
    device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("hand instances"),
        size: (capacity * size_of::<InstanceRaw>()) as u64,
        usage: wgpu::BufferUsages::VERTEX | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}

#[cfg(test)]
mod tests {
    use naga::{
        back::glsl,
        front::wgsl,
        proc::BoundsCheckPolicies,
        valid::{Capabilities, ValidationFlags, Validator},
    };
    use nalgebra::Matrix4;

    use super::*;

    type EntryPoints = &'static [(&'static str, naga::ShaderStage)];

    const SHADERS: [(&str, &str, EntryPoints); 2] = [
        (
            "scene.wgsl",
            include_str!("scene.wgsl"),
            &[
                ("vs_solid", naga::ShaderStage::Vertex),
                ("fs_solid", naga::ShaderStage::Fragment),
                ("vs_grid", naga::ShaderStage::Vertex),
                ("fs_grid", naga::ShaderStage::Fragment),
            ],
        ),
        (
            "copy.wgsl",
            include_str!("copy.wgsl"),
            &[
                ("vs_copy", naga::ShaderStage::Vertex),
                ("fs_copy_encoded", naga::ShaderStage::Fragment),
                ("fs_copy_linear", naga::ShaderStage::Fragment),
            ],
        ),
    ];

    #[test]
    fn shaders_are_valid_and_translate_to_what_webgl2_speaks() {
        for (file, text, entries) in SHADERS {
            let module = wgsl::parse_str(text)
                .unwrap_or_else(|error| panic!("{}", error.emit_to_string_with_path(text, file)));
            let info =
                Validator::new(ValidationFlags::all(), Capabilities::empty()).validate(&module).expect(file);
            for &(entry_point, shader_stage) in entries {
                let options = glsl::Options {
                    version: glsl::Version::Embedded { version: 300, is_webgl: true },
                    ..glsl::Options::default()
                };
                let pipeline = glsl::PipelineOptions {
                    shader_stage,
                    entry_point: entry_point.to_owned(),
                    multiview: None,
                };
                let mut out = String::new();
                glsl::Writer::new(
                    &mut out,
                    &module,
                    &info,
                    &options,
                    &pipeline,
                    BoundsCheckPolicies::default(),
                )
                .and_then(|mut writer| writer.write())
                .unwrap_or_else(|error| panic!("{file} {entry_point}: {error}"));
                assert!(out.starts_with("#version 300 es"), "{file} {entry_point}");
            }
        }
    }

    #[test]
    fn the_shader_reads_the_globals_as_they_are_written() {
        let module = wgsl::parse_str(SHADERS[0].1).expect("valid");
        let (_, globals) =
            module.types.iter().find(|(_, ty)| ty.name.as_deref() == Some("Globals")).expect("the uniform");
        let naga::TypeInner::Struct { members, span } = &globals.inner else { panic!("a struct") };
        assert_eq!(*span as usize, size_of::<Globals>());
        let offset = |name: &str| {
            members.iter().find(|member| member.name.as_deref() == Some(name)).expect(name).offset as usize
        };
        assert_eq!(offset("eye"), std::mem::offset_of!(Globals, eye));
        assert_eq!(offset("lamp"), std::mem::offset_of!(Globals, lamp));
        assert_eq!(offset("mark"), std::mem::offset_of!(Globals, mark));
        assert_eq!(offset("grid_color"), std::mem::offset_of!(Globals, grid_color));
        assert_eq!(offset("grid"), std::mem::offset_of!(Globals, grid));
    }

    #[test]
    fn neighbours_of_one_mesh_are_drawn_together_and_glass_apart() {
        let instance = |mesh: usize, alpha: f32| Instance {
            mesh,
            root_from_mesh: Matrix4::identity(),
            color: [1.0, 1.0, 1.0, alpha],
            unlit: 0.0,
            rim: 0.0,
        };
        let instances =
            [instance(3, 1.0), instance(3, 1.0), instance(1, 1.0), instance(3, 1.0), instance(3, 0.5)];
        let drawn: Vec<_> =
            batches(&instances).into_iter().map(|b| (b.mesh, b.translucent, b.instances)).collect();
        assert_eq!(drawn, [(3, false, 0..2), (1, false, 2..3), (3, false, 3..4), (3, true, 4..5)]);
    }
}
