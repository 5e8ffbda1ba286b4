//! One description of a layout that both reads and writes it.

/// Why bytes are not what a layout describes.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LayoutError {
    /// The bytes end inside the layout.
    #[error("{num_bytes} bytes, too few for the layout")]
    TooShort {
        /// Bytes there were.
        num_bytes: usize,
    },
    /// Bytes are left over.
    #[error("{num_left} bytes behind the end of the layout")]
    TooLong {
        /// Bytes left over.
        num_left: usize,
    },
    /// A number is not finite.
    #[error("byte {at}: the number is not finite")]
    NonFinite {
        /// First byte of the number.
        at: usize,
    },
}

/// Visits the fields of a value in the order of their bytes: a reader fills them in, a writer takes them.
pub(crate) trait Fields {
    /// The next bytes, which become or are `bytes`.
    fn raw<const N: usize>(&mut self, bytes: &mut [u8; N]);
    /// As many bytes as there are.
    fn rest(&mut self, bytes: &mut Vec<u8>);
    /// Whether an optional field of this size is there, given whether the value has it.
    fn present(&mut self, has: bool, num_bytes: usize) -> bool;
    /// Notes that the number just visited is not finite.
    fn non_finite(&mut self);

    fn u8(&mut self, value: &mut u8) {
        let mut bytes = [*value];
        self.raw(&mut bytes);
        [*value] = bytes;
    }

    fn u16(&mut self, value: &mut u16) {
        let mut bytes = value.to_be_bytes();
        self.raw(&mut bytes);
        *value = u16::from_be_bytes(bytes);
    }

    fn u32(&mut self, value: &mut u32) {
        let mut bytes = value.to_be_bytes();
        self.raw(&mut bytes);
        *value = u32::from_be_bytes(bytes);
    }

    fn u64(&mut self, value: &mut u64) {
        let mut bytes = value.to_be_bytes();
        self.raw(&mut bytes);
        *value = u64::from_be_bytes(bytes);
    }

    /// A little-endian single on the line, `per_unit` of it in one unit of `value`.
    fn f32(&mut self, value: &mut f64, per_unit: f64) {
        let mut bytes = ((*value * per_unit) as f32).to_le_bytes();
        self.raw(&mut bytes);
        let single = f32::from_le_bytes(bytes);
        if !single.is_finite() {
            self.non_finite();
        }
        *value = f64::from(single) / per_unit;
    }

    fn f32s(&mut self, values: &mut [f64], per_unit: f64) {
        for value in values {
            self.f32(value, per_unit);
        }
    }

    fn optional<T: Default>(
        &mut self,
        value: &mut Option<T>,
        num_bytes: usize,
        visit: impl FnOnce(&mut Self, &mut T),
    ) where
        Self: Sized,
    {
        if self.present(value.is_some(), num_bytes) {
            visit(self, value.get_or_insert_with(T::default));
        }
    }
}

pub(crate) struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
    error: Option<LayoutError>,
}

impl<'a> Reader<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0, error: None }
    }

    pub(crate) fn finish(self) -> Result<(), LayoutError> {
        match self.error {
            Some(error) => Err(error),
            None if self.at < self.bytes.len() => {
                Err(LayoutError::TooLong { num_left: self.bytes.len() - self.at })
            }
            None => Ok(()),
        }
    }
}

impl Fields for Reader<'_> {
    fn raw<const N: usize>(&mut self, bytes: &mut [u8; N]) {
        match self.bytes[self.at..].first_chunk::<N>() {
            Some(found) => {
                *bytes = *found;
                self.at += N;
            }
            None => {
                self.at = self.bytes.len();
                self.error.get_or_insert(LayoutError::TooShort { num_bytes: self.bytes.len() });
            }
        }
    }

    fn rest(&mut self, bytes: &mut Vec<u8>) {
        *bytes = self.bytes[self.at..].to_vec();
        self.at = self.bytes.len();
    }

    fn present(&mut self, _has: bool, num_bytes: usize) -> bool {
        self.bytes.len() - self.at >= num_bytes
    }

    fn non_finite(&mut self) {
        self.error.get_or_insert(LayoutError::NonFinite { at: self.at.saturating_sub(4) });
    }
}

#[derive(Default)]
pub(crate) struct Writer {
    pub(crate) bytes: Vec<u8>,
    pub(crate) non_finite_at: Option<usize>,
}

impl Writer {
    pub(crate) fn finish(self) -> Result<Vec<u8>, LayoutError> {
        match self.non_finite_at {
            Some(at) => Err(LayoutError::NonFinite { at }),
            None => Ok(self.bytes),
        }
    }
}

impl Fields for Writer {
    fn raw<const N: usize>(&mut self, bytes: &mut [u8; N]) {
        self.bytes.extend_from_slice(bytes);
    }

    fn rest(&mut self, bytes: &mut Vec<u8>) {
        self.bytes.extend_from_slice(bytes);
    }

    fn present(&mut self, has: bool, _num_bytes: usize) -> bool {
        has
    }

    fn non_finite(&mut self) {
        self.non_finite_at.get_or_insert(self.bytes.len().saturating_sub(4));
    }
}
