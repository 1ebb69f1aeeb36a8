//! Where registers, clock gates, interrupts and DMA requests are: all from the metadata of `stm32-metapac`, which the
//! firmware's driver library is generated from. A test compares every bit of the modelled registers with ST's own
//! header (`tests/st_header.csv`), because a mistake in the metadata would otherwise be made twice, by driver and
//! emulator, and go unnoticed.

use stm32_metapac::metadata::ir::{Array, Block, BlockItem, BlockItemInner, IR};
use stm32_metapac::metadata::{METADATA, Peripheral};

/// Defines the byte offsets of a block's registers, and a table of them for the test.
macro_rules! registers {
    ($peripheral:literal: $($name:ident = $offset:literal),+ $(,)?) => {
        $(const $name: u32 = $offset;)+
        /// Peripheral that has the block, and the offsets that its model uses.
        #[cfg(test)]
        pub(crate) const OFFSETS: (&str, &[(&str, u32)]) = ($peripheral, &[$((stringify!($name), $offset)),+]);
    };
}
pub(crate) use registers;

/// A peripheral of the chip by its name in the reference manual.
///
/// # Panics
/// The chip has none of this name.
pub(crate) fn peripheral(name: &str) -> &'static Peripheral {
    let mut all = METADATA.peripherals.iter();
    all.find(|peripheral| peripheral.name == name)
        .unwrap_or_else(|| panic!("the chip has no peripheral {name}"))
}

/// Base address of a peripheral.
///
/// # Panics
/// The chip has none of this name.
pub fn base(name: &str) -> u32 {
    peripheral(name).address as u32
}

/// Number of an interrupt.
///
/// # Panics
/// The chip has none of this name.
pub fn interrupt(name: &str) -> usize {
    let mut all = METADATA.interrupts.iter();
    let found = all.find(|interrupt| interrupt.name == name);
    found.unwrap_or_else(|| panic!("the chip has no interrupt {name}")).number as usize
}

/// Name of an interrupt.
pub fn interrupt_name(number: usize) -> &'static str {
    let mut all = METADATA.interrupts.iter();
    let found = all.find(|interrupt| interrupt.number as usize == number);
    found.map_or("?", |interrupt| interrupt.name)
}

/// Number of a DMA request, as in DMAMUX.
///
/// # Panics
/// The peripheral has no such request.
pub(crate) fn dma_request(name: &str, signal: &str) -> u8 {
    let mut channels = peripheral(name).dma_channels.iter();
    let request =
        channels.find(|channel| channel.signal == signal).and_then(|channel| channel.request);
    request.unwrap_or_else(|| panic!("{name} has no DMA request {signal}")) as u8
}

/// Alternate function by which a pin (as `PB9`) is a signal of a peripheral.
pub fn alternate_function(name: &str, signal: &str, pin: &str) -> Option<u8> {
    let mut pins = peripheral(name).pins.iter();
    pins.find(|candidate| candidate.pin == pin && candidate.signal == signal).and_then(|pin| pin.af)
}

/// A bit of a register of RCC: its byte offset and its number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct RccBit {
    pub(crate) offset: u32,
    pub(crate) bit: u32,
}

/// The bits that switch a peripheral's clock on and that reset it. None where it has no gate.
pub(crate) fn rcc_bits(name: &str) -> Option<[RccBit; 2]> {
    let rcc = peripheral(name).rcc.as_ref()?;
    let (enable, reset) = (rcc.enable.as_ref()?, rcc.reset.as_ref()?);
    Some(
        [(enable.register, enable.field), (reset.register, reset.field)]
            .map(|(register, field)| rcc_bit(register, field)),
    )
}

fn rcc_bit(register: &str, field: &str) -> RccBit {
    let ir = block_ir("RCC");
    let item = items(ir, ir.blocks.iter().find(|block| block.name == "Rcc"));
    let (_, offset, set) = item
        .into_iter()
        .find(|(name, _, _)| name.eq_ignore_ascii_case(register))
        .unwrap_or_else(|| panic!("RCC has no register {register}"));
    let fields =
        ir.fieldsets.iter().find(|candidate| Some(candidate.name) == set).map(|set| set.fields);
    let mut fields = fields.unwrap_or_default().iter();
    let field = fields
        .find(|candidate| candidate.name.eq_ignore_ascii_case(field))
        .unwrap_or_else(|| panic!("RCC_{register} has no bit {field}"));
    let stm32_metapac::metadata::ir::BitOffset::Regular(bit) = &field.bit_offset else {
        panic!("RCC_{register}.{} is not one bit", field.name)
    };
    RccBit { offset, bit: bit.offset }
}

fn block_ir(name: &str) -> &'static IR {
    let registers = peripheral(name).registers.as_ref();
    registers.unwrap_or_else(|| panic!("{name} has no registers")).ir
}

/// Name, offset and set of fields of each register of a block, arrays and inner blocks written out. Registers of an
/// extended block come first.
fn items(
    ir: &'static IR,
    block: Option<&'static Block>,
) -> Vec<(String, u32, Option<&'static str>)> {
    let mut found = Vec::new();
    for item in block.map_or(&[][..], |block| block.items) {
        for (suffix, place) in places(item) {
            match &item.inner {
                BlockItemInner::Register(register) => {
                    found.push((
                        format!("{}{suffix}", item.name).to_uppercase(),
                        place,
                        register.fieldset,
                    ));
                }
                BlockItemInner::Block(inner) => {
                    let inner = ir.blocks.iter().find(|block| block.name == inner.block);
                    let inner = items(ir, inner).into_iter();
                    found.extend(inner.map(|(name, offset, set)| {
                        (
                            format!("{}{suffix}_{name}", item.name).to_uppercase(),
                            place + offset,
                            set,
                        )
                    }));
                }
            }
        }
    }
    found
}

/// Offsets of an item's elements, with their number where there is more than one.
fn places(item: &BlockItem) -> Vec<(String, u32)> {
    let offsets = match &item.array {
        None => return vec![(String::new(), item.byte_offset)],
        Some(Array::Regular(array)) => (0..array.len).map(|place| place * array.stride).collect(),
        Some(Array::Cursed(array)) => array.offsets.to_vec(),
    };
    let numbered = offsets.into_iter().enumerate();
    numbered.map(|(place, offset)| (place.to_string(), item.byte_offset + offset)).collect()
}

/// Registers of a peripheral: name, byte offset, name of the set of fields.
pub(crate) fn registers_of(name: &str) -> Vec<(String, u32, Option<&'static str>)> {
    let ir = block_ir(name);
    let own = peripheral(name).registers.as_ref().map(|registers| registers.block);
    // Names of blocks are upper case in the one place, camel case in the other.
    let plain = |text: &str| text.replace('_', "").to_lowercase();
    let block =
        ir.blocks.iter().find(|block| own.is_some_and(|own| plain(own) == plain(block.name)));
    items(ir, block)
}

/// What is at an address, as `I2C1.CR2`.
pub fn name(address: u32) -> String {
    let below =
        METADATA.peripherals.iter().filter(|peripheral| peripheral.address as u32 <= address);
    let nearest = below.max_by_key(|peripheral| peripheral.address);
    let Some(peripheral) =
        nearest.filter(|peripheral| address - (peripheral.address as u32) < 0x400)
    else {
        return "?".to_owned();
    };
    if peripheral.registers.is_none() {
        return peripheral.name.to_owned();
    }
    let offset = address - peripheral.address as u32;
    let register = registers_of(peripheral.name).into_iter().find(|(_, place, _)| *place == offset);
    match register {
        Some((register, _, _)) => format!("{}.{register}", peripheral.name),
        None => format!("{}+{offset:#x}", peripheral.name),
    }
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, BTreeSet};

    use stm32_metapac::metadata::ir::{BitOffset, Field};

    use super::*;
    use crate::peripherals::*;

    /// Every block that has a model, and the offsets of its registers.
    const MODELLED: &[(&str, &[(&str, u32)])] = &[
        adc::OFFSETS,
        clocks::OFFSETS,
        dma::OFFSETS,
        fdcan::OFFSETS,
        flash::OFFSETS,
        gpio::OFFSETS,
        i2c::OFFSETS,
        motor_timer::OFFSETS,
        power::OFFSETS,
        rng::OFFSETS,
        spi::OFFSETS,
        syscfg::OFFSETS,
        timer::OFFSETS,
        usart::OFFSETS,
        watchdog::OFFSETS,
    ];

    #[test]
    fn addresses_have_the_names_of_the_reference_manual() {
        assert_eq!(name(0x4000_5404), "I2C1.CR2");
        assert_eq!(name(0x4000_7080), "PWR.CR5");
        assert_eq!(name(0x4002_001c), "DMA1.CH1_CR");
        assert_eq!(name(0x5000_0308), "ADC12_COMMON.CCR");
        assert_eq!(name(0x1000_0000), "?");
    }

    /// Positions and widths of ST's bit fields, by their names without separators.
    fn st_fields() -> BTreeMap<String, (u32, u32)> {
        let rows = include_str!("../tests/st_header.csv")
            .lines()
            .filter(|line| !line.starts_with('#'))
            .skip(1);
        rows.map(|row| {
            let [name, position, width] = row.split(',').collect::<Vec<_>>()[..] else {
                panic!("{row}")
            };
            (name.replace('_', ""), (position.parse().unwrap(), width.parse().unwrap()))
        })
        .collect()
    }

    #[test]
    fn offsets_are_those_of_the_metadata() {
        for (name, offsets) in MODELLED {
            let known = registers_of(name);
            for (register, offset) in *offsets {
                let found =
                    known.iter().any(|(known, place, _)| known == register && place == offset);
                assert!(found, "{name}.{register} is not at {offset:#x}");
            }
        }
    }

    /// Where ST's header and the metadata differ, as far as they name a field alike.
    const DIFFERENT: [&str; 4] = [
        // The metadata are wrong: the driver library's boost mode does nothing (`peripherals/power.rs`).
        "PWR.CR5.r1mode",
        // ST calls this field PLLPDIV, and the bit 17 PLLP.
        "RCC.PLLCFGR.pllp",
        // 16 bits by the metadata, 32 in the header's mask; RM0440 28.6.13 and 28.6.15 have 16 and a dithering mode.
        "TIM1.ARR.arr",
        "TIM1.CNT.cnt",
    ];

    #[test]
    fn bits_of_the_metadata_are_those_of_st() {
        let st = st_fields();
        let (mut compared, mut different) = (0, BTreeSet::new());
        for (name, offsets) in MODELLED {
            let block = name.trim_end_matches(char::is_numeric);
            for (register, _, set) in registers_of(name) {
                if !offsets.iter().any(|(modelled, _)| *modelled == register) {
                    continue;
                }
                let ir = block_ir(name);
                let fields = ir
                    .fieldsets
                    .iter()
                    .find(|candidate| Some(candidate.name) == set)
                    .map(|set| set.fields);
                for field in fields.unwrap_or_default() {
                    let candidates = candidates(block, &register, field);
                    let known: Vec<_> = candidates
                        .iter()
                        .filter_map(|(name, place)| Some((st.get(name)?, place)))
                        .collect();
                    if known.is_empty() {
                        continue;
                    }
                    compared += 1;
                    if !known.iter().any(|((position, width), place)| {
                        position == *place && *width == field.bit_size
                    }) {
                        different.insert(format!("{name}.{register}.{}", field.name));
                    }
                }
            }
        }
        assert_eq!(different.iter().map(String::as_str).collect::<Vec<_>>(), DIFFERENT);
        assert!(compared > 550, "only {compared} fields were compared");
    }

    /// Names that ST may give a field, and where its first bit should be: arrays are numbered from 0 or from 1, and so are
    /// registers.
    fn candidates(block: &str, register: &str, field: &Field) -> Vec<(String, u32)> {
        let BitOffset::Regular(first) = &field.bit_offset else {
            return Vec::new();
        };
        let numbered = register.trim_end_matches(char::is_numeric);
        let strides: Vec<_> = match &field.array {
            None => vec![(String::new(), 0)],
            Some(Array::Regular(array)) => {
                (0..array.len).map(|place| (place.to_string(), place * array.stride)).collect()
            }
            Some(Array::Cursed(array)) => array
                .offsets
                .iter()
                .enumerate()
                .map(|(place, offset)| (place.to_string(), *offset))
                .collect(),
        };
        let from_one = strides.iter().filter_map(|(place, shift)| {
            Some(((place.parse::<u32>().ok()? + 1).to_string(), *shift))
        });
        let places: Vec<_> = strides.iter().cloned().chain(from_one).collect();
        let registers = [register, numbered].into_iter();
        registers
            .flat_map(|register| {
                places.iter().map(move |(place, shift)| {
                    let name = format!("{block}{register}{}{place}", field.name)
                        .to_uppercase()
                        .replace('_', "");
                    (name, first.offset + shift)
                })
            })
            .collect()
    }

    #[test]
    fn clock_gates_and_interrupts_are_those_of_the_reference_manual() {
        // RM0440 7.4.18 and 7.4.10: I2C1EN is bit 21 of APB1ENR1 (0x58), I2C1RST of APB1RSTR1 (0x38).
        assert_eq!(
            rcc_bits("I2C1"),
            Some([RccBit { offset: 0x58, bit: 21 }, RccBit { offset: 0x38, bit: 21 }])
        );
        // RM0440 table 97 (vectors) and table 91 (DMAMUX requests).
        assert_eq!([interrupt("ADC1_2"), interrupt("TIM5"), interrupt("FMAC")], [18, 50, 101]);
        assert_eq!([dma_request("I2C1", "RX"), dma_request("USART2", "TX")], [16, 27]);
        assert_eq!(alternate_function("I2C1", "SCL", "PA15"), Some(4));
    }
}
