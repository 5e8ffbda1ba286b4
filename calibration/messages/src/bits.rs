//! Activations as bits, least significant bit first.

/// Packs one bool a bit.
pub fn pack(active: impl IntoIterator<Item = bool>) -> Vec<u8> {
    let mut bytes = Vec::new();
    for (bit_idx, on) in active.into_iter().enumerate() {
        if bit_idx % 8 == 0 {
            bytes.push(0);
        }
        if on && let Some(last) = bytes.last_mut() {
            *last |= 1 << (bit_idx % 8);
        }
    }
    bytes
}

/// The bit at `bit_idx`; false past the end.
pub fn get(bytes: &[u8], bit_idx: usize) -> bool {
    bytes.get(bit_idx / 8).is_some_and(|byte| byte >> (bit_idx % 8) & 1 == 1)
}

/// The first `len` bits as bools.
pub fn unpack(bytes: &[u8], len: usize) -> Vec<bool> {
    (0..len).map(|bit_idx| get(bytes, bit_idx)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unpack_inverts_pack_at_every_length() {
        for len in 0..40_usize {
            let active: Vec<bool> = (0..len).map(|bit_idx| bit_idx % 3 == 1 || bit_idx % 7 == 0).collect();
            let bytes = pack(active.iter().copied());
            assert_eq!(bytes.len(), len.div_ceil(8));
            assert_eq!(unpack(&bytes, len), active);
        }
    }

    #[test]
    fn the_first_bit_is_the_least_significant() {
        assert_eq!(pack([true, false, false, false, false, false, false, false, true]), [1, 1]);
        assert!(get(&[4], 2) && !get(&[4], 1));
    }

    #[test]
    fn bits_past_the_end_are_false() {
        assert!(!get(&[0xff], 8));
    }
}
