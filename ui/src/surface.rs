//! What the page paints on.

/// A wgpu surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Surface {
    /// Its colours.
    pub format: wgpu::TextureFormat,
    /// Whether the processor paints, for want of a graphics card. Edges are rough then: a hand that moves jerkily says less.
    pub by_processor: bool,
}

impl Surface {
    /// The surface of colour `format` that `adapter` paints on.
    pub fn new(format: wgpu::TextureFormat, adapter: &wgpu::Adapter) -> Self {
        Self { format, by_processor: adapter.get_info().device_type == wgpu::DeviceType::Cpu }
    }
}
