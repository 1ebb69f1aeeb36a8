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

/// CRC-32/ISO-HDLC: polynomial 0x04C11DB7 from all ones, the lowest bit first, inverted.
pub fn crc32(bytes: &[u8]) -> u32 {
    let next = |crc: u32, byte: &u8| (crc >> 8) ^ CRC32_OF_BYTE[usize::from(crc as u8 ^ byte)];
    // Chunks of a fixed length: with one comparison for each byte the coverage takes longer than the checksum.
    let (chunks, rest) = bytes.as_chunks::<16>();
    let crc = chunks.iter().fold(u32::MAX, |crc, chunk| chunk.iter().fold(crc, next));
    !rest.iter().fold(crc, next)
}

/// The remainder of each byte, bit by bit. Calibrations of 25 KB are too long for single bits.
const CRC32_OF_BYTE: [u32; 256] = {
    let mut all = [0; 256];
    let mut byte = 0;
    while byte < all.len() {
        let (mut crc, mut bit) = (byte as u32, 0);
        while bit < 8 {
            crc = if crc & 1 == 0 { crc >> 1 } else { (crc >> 1) ^ 0xEDB8_8320 };
            bit += 1;
        }
        all[byte] = crc;
        byte += 1;
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
