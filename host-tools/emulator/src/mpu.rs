//! Memory protection unit of the core (ARMv7-M, B3.5), as far as firmware keeps the core out of regions: no access to anybody.

/// Addresses of its registers.
const CONTROL: u32 = 0xE000_ED94;
const NUMBER: u32 = 0xE000_ED98;
const BASE: u32 = 0xE000_ED9C;
const ATTRIBUTES: u32 = 0xE000_EDA0;
const REGIONS: usize = 8;
const ENABLE: u32 = 1;

/// The unit.
#[derive(Clone, Default)]
pub(crate) struct Mpu {
    control: u32,
    number: u32,
    /// RBAR and RASR of each region.
    regions: [[u32; 2]; REGIONS],
}

impl Mpu {
    /// Whether a region keeps the core out of this address.
    pub(crate) fn forbids(&self, address: u32) -> bool {
        let is_within = |[base, attributes]: &[u32; 2]| {
            let size = 2_u64 << (attributes >> 1 & 0x1F);
            attributes & ENABLE != 0
                && attributes >> 24 & 7 == 0
                && u64::from(address.wrapping_sub(base & !0x1F)) < size
        };
        self.control & ENABLE != 0 && self.regions.iter().any(is_within)
    }

    fn region(&mut self) -> &mut [u32; 2] {
        &mut self.regions[self.number as usize % REGIONS]
    }

    /// A register; none where the address is none of its.
    pub(crate) fn read(&mut self, address: u32) -> Option<u32> {
        match address {
            CONTROL => Some(self.control),
            NUMBER => Some(self.number),
            BASE => Some(self.region()[0]),
            ATTRIBUTES => Some(self.region()[1]),
            _ => None,
        }
    }

    /// Writes a register; false where the address is none of its.
    pub(crate) fn write(&mut self, address: u32, value: u32) -> bool {
        match address {
            CONTROL => self.control = value,
            NUMBER => self.number = value,
            BASE => {
                if value & 0x10 != 0 {
                    self.number = value & 0xF;
                }
                self.region()[0] = value;
            }
            ATTRIBUTES => self.region()[1] = value,
            _ => return false,
        }
        true
    }
}
