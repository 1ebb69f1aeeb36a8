//! Checksums and stuffing by their definitions, beside the tables of the gripper's libraries.

/// CRC-16/IBM-3740: polynomial 0x1021 from all ones, bit by bit, the highest first.
pub fn crc16(bytes: impl IntoIterator<Item = u8>) -> u16 {
    let bit = |crc: u16| match crc & 0x8000 {
        0 => crc << 1,
        _ => (crc << 1) ^ 0x1021,
    };
    bytes
        .into_iter()
        .fold(0xFFFF, |crc, byte| (0..8).fold(crc ^ (u16::from(byte) << 8), |crc, _| bit(crc)))
}

/// CRC-32/ISO-HDLC: polynomial 0x04C11DB7 from all ones, the lowest bit first, inverted. Eight bytes at a time, each with the
/// remainder at its distance from the end: calibrations are too long for single bytes.
pub fn crc32(bytes: &[u8]) -> u32 {
    let (words, rest) = bytes.as_chunks::<8>();
    let crc = words.iter().fold(u32::MAX, |crc, word| {
        let [a, b, c, d] = crc.to_le_bytes();
        let [e, f, g, h, last @ ..] = *word;
        let [i, j, k, l] = last;
        let [t0, t1, t2, t3, t4, t5, t6, t7] = &CRC32_OF_BYTE;
        let at = |table: &[u32; 256], byte: u8| table[usize::from(byte)];
        at(t7, a ^ e)
            ^ at(t6, b ^ f)
            ^ at(t5, c ^ g)
            ^ at(t4, d ^ h)
            ^ at(t3, i)
            ^ at(t2, j)
            ^ at(t1, k)
            ^ at(t0, l)
    });
    let [of_byte, ..] = &CRC32_OF_BYTE;
    !rest.iter().fold(crc, |crc, byte| (crc >> 8) ^ of_byte[usize::from(crc as u8 ^ byte)])
}

/// The remainder of each byte that is followed by 0 to 7 zeros, the first bit by bit.
const CRC32_OF_BYTE: [[u32; 256]; 8] = {
    let mut all = [[0; 256]; 8];
    let mut byte = 0;
    while byte < 256 {
        let (mut crc, mut bit) = (byte as u32, 0);
        while bit < 8 {
            crc = if crc & 1 == 0 { crc >> 1 } else { (crc >> 1) ^ 0xEDB8_8320 };
            bit += 1;
        }
        all[0][byte] = crc;
        byte += 1;
    }
    let mut zeros = 1;
    while zeros < all.len() {
        byte = 0;
        while byte < 256 {
            let shorter = all[zeros - 1][byte];
            all[zeros][byte] = (shorter >> 8) ^ all[0][(shorter & 0xFF) as usize];
            byte += 1;
        }
        zeros += 1;
    }
    all
};

/// Consistent overhead byte stuffing (Cheshire and Baker 1999), with the zero that ends it: each run of
/// bytes without a zero follows its length plus one; a run of 254 has no zero after it.
pub fn stuffed(bytes: &[u8]) -> Vec<u8> {
    let mut line = Vec::with_capacity(bytes.len() + 3);
    for run in bytes.split(|byte| *byte == 0) {
        let mut rest = run;
        while let Some((full, left)) = rest.split_at_checked(254) {
            line.push(0xFF);
            line.extend_from_slice(full);
            rest = left;
        }
        line.push(rest.len() as u8 + 1);
        line.extend_from_slice(rest);
    }
    line.push(0);
    line
}

/// The bytes before [`stuffed`] made a line of them, without its zero; what does not add up is left out.
pub fn unstuffed(line: &[u8]) -> Vec<u8> {
    let (mut bytes, mut rest) = (Vec::new(), line);
    while let [code, others @ ..] = rest {
        let (run, left) = others.split_at((usize::from(*code).max(1) - 1).min(others.len()));
        bytes.extend_from_slice(run);
        if *code < 0xFF && !left.is_empty() {
            bytes.push(0);
        }
        rest = left;
    }
    bytes
}
