/// What a decoder has done with the bytes it was fed, since it was made.
///
/// `frame_bytes + dropped_bytes + pending` equals the number of bytes fed at any time, where `pending` is what the
/// decoder still holds because a frame may be in it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct DecodeCounters {
    /// Frames delivered.
    pub frames: u64,
    /// Bytes of delivered frames, headers and checksums included.
    pub frame_bytes: u64,
    /// Bytes that belong to no delivered frame.
    pub dropped_bytes: u64,
    /// Frames that looked complete and failed their checksum.
    pub crc_errors: u64,
    /// Headers, lengths or contents that no valid frame has, without a checksum or despite a good one.
    pub malformed: u64,
}

impl DecodeCounters {
    pub(crate) fn deliver(&mut self, num_bytes: usize) {
        self.frames += 1;
        self.frame_bytes += num_bytes as u64;
    }

    pub(crate) fn drop_bytes(&mut self, num_bytes: usize) {
        self.dropped_bytes += num_bytes as u64;
    }
}
