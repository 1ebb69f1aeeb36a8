//! Blocks of addresses with their clock gates and interrupts, alternate functions of the pins, request lines of DMA.

use crate::peripherals::gpio::Pin;
use crate::registers::{RccBit, base, dma_request, interrupt, rcc_bits};
use crate::wiring::Wiring;

/// Size of a block: each peripheral has blocks of its own.
pub(super) const BLOCK: u32 = 1024;

/// What answers in a block of addresses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Block {
    Adc12,
    Adc345,
    Dma(usize),
    DmaMux,
    Fdcan,
    FdcanRam,
    Flash,
    Gpio(usize),
    I2c(usize),
    Iwdg,
    Pwr,
    Rcc,
    Rng,
    Spi(usize),
    Syscfg,
    Tim1,
    Tim5,
    Usart,
}

/// The blocks, by their names in the metadata.
pub(super) const BLOCKS: [(&str, Block); 28] = [
    ("TIM5", Block::Tim5),
    ("TIM1", Block::Tim1),
    ("ADC1", Block::Adc12),
    ("ADC3", Block::Adc345),
    ("GPIOA", Block::Gpio(0)),
    ("GPIOB", Block::Gpio(1)),
    ("GPIOC", Block::Gpio(2)),
    ("GPIOD", Block::Gpio(3)),
    ("GPIOE", Block::Gpio(4)),
    ("GPIOF", Block::Gpio(5)),
    ("GPIOG", Block::Gpio(6)),
    ("I2C1", Block::I2c(0)),
    ("I2C2", Block::I2c(1)),
    ("I2C3", Block::I2c(2)),
    ("USART2", Block::Usart),
    ("FDCAN1", Block::Fdcan),
    ("FDCANRAM1", Block::FdcanRam),
    ("DMA1", Block::Dma(0)),
    ("DMA2", Block::Dma(1)),
    ("DMAMUX1", Block::DmaMux),
    ("SPI1", Block::Spi(0)),
    ("SPI3", Block::Spi(1)),
    ("FLASH", Block::Flash),
    ("IWDG", Block::Iwdg),
    ("RCC", Block::Rcc),
    ("PWR", Block::Pwr),
    ("RNG", Block::Rng),
    ("SYSCFG", Block::Syscfg),
];

/// A block with its clock gate and reset, where it has them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Entry {
    pub(super) block: Block,
    pub(super) base: u32,
    pub(super) bits: Option<[RccBit; 2]>,
}

/// A request line of DMA: the peripheral and which of its two, receive or transmit.
#[derive(Clone, Copy, Debug)]
pub(super) struct Request {
    pub(super) block: Block,
    pub(super) line: usize,
}

/// Numbers of the interrupts.
#[derive(Clone)]
pub(super) struct Interrupts {
    pub(super) i2c: [[usize; 2]; 3],
    pub(super) fdcan: [usize; 2],
    pub(super) tim1: [usize; 2],
    pub(super) usart: usize,
    pub(super) tim5: usize,
    pub(super) adc: usize,
    pub(super) rng: usize,
    pub(super) flash: usize,
}

impl Interrupts {
    pub(super) fn new() -> Self {
        let pairs = |names: [&str; 2]| names.map(interrupt);
        Self {
            i2c: [["I2C1_EV", "I2C1_ER"], ["I2C2_EV", "I2C2_ER"], ["I2C3_EV", "I2C3_ER"]]
                .map(pairs),
            fdcan: pairs(["FDCAN1_IT0", "FDCAN1_IT1"]),
            tim1: pairs(["TIM1_BRK_TIM15", "TIM1_UP_TIM16"]),
            usart: interrupt("USART2"),
            tim5: interrupt("TIM5"),
            adc: interrupt("ADC1_2"),
            rng: interrupt("RNG"),
            flash: interrupt("FLASH"),
        }
    }
}

#[derive(Clone)]
pub(super) struct Functions {
    pub(super) bridges: [(Pin, u8); 6],
    pub(super) break_input: (Pin, u8),
    pub(super) serial: [(Pin, u8); 2],
    pub(super) can: [(Pin, u8); 2],
    pub(super) spi: [[(Pin, u8); 3]; 2],
    /// Of each I2C peripheral at each bus, where it can be there.
    pub(super) i2c: [[Option<[u8; 2]>; 2]; 3],
}

impl Functions {
    pub(super) fn new(wiring: &Wiring) -> Self {
        fn with<const N: usize>(name: &str, signals: [&str; N], pins: [Pin; N]) -> [(Pin, u8); N] {
            let functions = Wiring::functions(name, signals, pins);
            let functions =
                functions.unwrap_or_else(|| panic!("{name} cannot have these pins: {pins:?}"));
            std::array::from_fn(|place| (pins[place], functions[place]))
        }
        let [[u, v, w], [un, vn, wn]] = wiring.bridges;
        let spi = |name: &str, [clock, out, into, _]: [Pin; 4]| {
            with(name, ["SCK", "MOSI", "MISO"], [clock, out, into])
        };
        let [break_input] = with("TIM1", ["BKIN"], [wiring.gate_fault]);
        let i2c = ["I2C1", "I2C2", "I2C3"].map(|name| {
            wiring.sensor_buses.map(|pins| Wiring::functions(name, ["SCL", "SDA"], pins))
        });
        Self {
            bridges: with(
                "TIM1",
                ["CH1", "CH2", "CH3", "CH1N", "CH2N", "CH3N"],
                [u, v, w, un, vn, wn],
            ),
            break_input,
            serial: with("USART2", ["RX", "TX"], wiring.serial),
            can: with("FDCAN1", ["RX", "TX"], wiring.can),
            spi: [spi("SPI1", wiring.encoder), spi("SPI3", wiring.inertial)],
            i2c,
        }
    }
}

/// The table of blocks with their addresses and gates.
pub(super) fn entries() -> Vec<Entry> {
    BLOCKS
        .into_iter()
        .map(|(name, block)| Entry { block, base: base(name), bits: gate(name, block) })
        .collect()
}

/// Clock gate and reset of a block; some have neither, or share those of another.
fn gate(name: &str, block: Block) -> Option<[RccBit; 2]> {
    match block {
        Block::FdcanRam => rcc_bits("FDCAN1"),
        _ => rcc_bits(name),
    }
}

pub(super) fn map(entries: &[Entry]) -> [Vec<u8>; 3] {
    [(0x4000_0000_u32, 0x2_4000_u32), (0x4800_0000, 0x1C00), (0x5000_0000, 0x6_0C00)].map(
        |(start, length)| {
            let mut map = vec![u8::MAX; (length / BLOCK) as usize];
            for (place, entry) in entries.iter().enumerate() {
                let block = entry.base.wrapping_sub(start) / BLOCK;
                if let Some(slot) = map.get_mut(block as usize) {
                    *slot = place as u8;
                }
            }
            map
        },
    )
}

pub(super) fn base_of(entries: &[Entry], block: Block) -> u32 {
    entries.iter().find(|entry| entry.block == block).map_or(0, |entry| entry.base)
}

pub(super) fn requests() -> [Option<Request>; 128] {
    let mut requests = [None; 128];
    let names = [
        ("I2C1", Block::I2c(0)),
        ("I2C2", Block::I2c(1)),
        ("I2C3", Block::I2c(2)),
        ("USART2", Block::Usart),
        ("SPI3", Block::Spi(1)),
    ];
    for (name, block) in names {
        for (line, signal) in ["RX", "TX"].into_iter().enumerate() {
            requests[usize::from(dma_request(name, signal))] = Some(Request { block, line });
        }
    }
    requests
}
