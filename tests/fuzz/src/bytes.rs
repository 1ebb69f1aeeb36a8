//! How a story is read from bytes.

/// Bytes that are taken from the front; zeros once they are used up.
pub struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    /// All of them.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self(bytes)
    }

    /// Whether they are used up.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// So many, or what is left.
    pub fn some(&mut self, count: usize) -> &'a [u8] {
        let (taken, left) = self.0.split_at(count.min(self.0.len()));
        self.0 = left;
        taken
    }

    /// Exactly so many.
    pub fn array<const N: usize>(&mut self) -> [u8; N] {
        let mut all = [0; N];
        let taken = self.some(N);
        all[..taken.len()].copy_from_slice(taken);
        all
    }

    pub fn byte(&mut self) -> u8 {
        let [byte] = self.array();
        byte
    }

    /// Two, as a number.
    pub fn word(&mut self) -> u16 {
        u16::from_le_bytes(self.array())
    }
}

/// Inserts, removes or replaces a character of an ASCII text.
pub fn change(text: &mut String, bytes: &mut Bytes) {
    let at = usize::from(bytes.word()) % text.len();
    let character = char::from(b' ' + bytes.byte() % 95);
    match bytes.byte() % 3 {
        0 => text.insert(at, character),
        1 => text.replace_range(at..=at, ""),
        _ => text.replace_range(at..=at, character.encode_utf8(&mut [0; 4])),
    }
}
