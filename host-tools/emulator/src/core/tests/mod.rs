//! Tests of the core with programs of literal halfwords.
//!
//! The expected values are worked out by hand from the architecture manual (DDI0403E). The mnemonics
//! are next to the halfwords; `arm-none-eabi-as` assembles the same halfwords.

mod code;
mod control_flow;
mod exceptions;
mod faults;
mod instructions;
mod lazy_float;
mod sleep;
mod system;
mod timing;

use std::ops::Range;

use crate::core::{Bus, BusError, Core, CycleModel, Pause, Stop, SystemControl, Width};

const FLASH: u32 = 0x0800_0000;
const CCM: u32 = 0x1000_0000;
const SRAM: u32 = 0x2000_0000;
const SRAM_SIZE: u32 = 0x2_0000;
/// Initial stack pointer.
const STACK: u32 = SRAM + 0x1000;
/// First instruction of the program.
const PROGRAM: u32 = FLASH + 0x400;
/// Free memory for data.
const DATA: u32 = SRAM + 0x2000;

/// BKPT 0, which ends a program.
const END: u16 = 0xBE00;

// Flags in the xPSR.
const N: u32 = 1 << 31;
const Z: u32 = 1 << 30;
const C: u32 = 1 << 29;
const V: u32 = 1 << 28;
const Q: u32 = 1 << 27;

/// Memories without peripherals; the flash is visible at address 0 too.
struct TestBus {
    flash: Vec<u8>,
    ccm: Vec<u8>,
    sram: Vec<u8>,
    system: SystemControl,
    time: u64,
    event_at: u64,
    modified: Option<Range<u32>>,
    /// A store to the first address changes the instruction at the second, as flash programming does.
    programming: Option<(u32, u32, u16)>,
}

impl TestBus {
    fn new() -> Self {
        Self {
            flash: vec![0xFF; 0x8_0000],
            ccm: vec![0; 0x8000],
            sram: vec![0; SRAM_SIZE as usize],
            system: SystemControl::new(),
            time: 0,
            // A program that does not end fails its test.
            event_at: 1_000_000,
            modified: None,
            programming: None,
        }
    }

    fn bytes(&mut self, address: u32, width: Width) -> Result<&mut [u8], BusError> {
        let (memory, start) = match address {
            0..0x8_0000 => (&mut self.flash, 0),
            FLASH..0x0808_0000 => (&mut self.flash, FLASH),
            CCM..0x1000_8000 => (&mut self.ccm, CCM),
            SRAM..0x2002_0000 => (&mut self.sram, SRAM),
            _ => return Err(BusError),
        };
        let start = (address - start) as usize;
        memory.get_mut(start..start + width.bytes() as usize).ok_or(BusError)
    }
}

impl Bus for TestBus {
    fn fetch(&mut self, address: u32) -> Result<u16, BusError> {
        self.read(address, Width::Half).map(|halfword| halfword as u16)
    }

    fn read(&mut self, address: u32, width: Width) -> Result<u32, BusError> {
        if address >= 0xE000_0000 {
            let word = self.system.read(address).ok_or(BusError)?;
            let lane = word >> (8 * (address & 3));
            return Ok(match width {
                Width::Byte => lane & 0xFF,
                Width::Half => lane & 0xFFFF,
                Width::Word => lane,
            });
        }
        let bytes = self.bytes(address, width)?;
        Ok(bytes.iter().rev().fold(0, |word, &byte| word << 8 | byte as u32))
    }

    fn write(&mut self, address: u32, width: Width, value: u32) -> Result<(), BusError> {
        if address >= 0xE000_0000 {
            return self.system.write(address, width, value).then_some(()).ok_or(BusError);
        }
        if address < CCM {
            return Err(BusError);
        }
        if let Some((trigger, target, halfword)) = self.programming
            && address == trigger
        {
            let bytes = self.bytes(target, Width::Half)?;
            bytes.copy_from_slice(&halfword.to_le_bytes());
            self.modified = Some(target..target + 2);
        }
        let bytes = self.bytes(address, width)?;
        bytes.copy_from_slice(&value.to_le_bytes()[..width.bytes() as usize]);
        Ok(())
    }

    fn system(&mut self) -> &mut SystemControl {
        &mut self.system
    }

    fn elapse(&mut self, cycles: u32) {
        self.time += cycles as u64;
    }

    fn event_due(&self) -> bool {
        self.time >= self.event_at
    }

    fn take_modified_code(&mut self) -> Option<Range<u32>> {
        self.modified.take()
    }
}

/// A core after its reset, with a program in flash.
struct Machine {
    core: Core,
    bus: TestBus,
}

impl Machine {
    /// The program, followed by BKPT; all exceptions but reset have no handler (address 0xFFFF_FFFE).
    fn new(program: &[u16]) -> Self {
        Self::with_model(program, CycleModel::FAST)
    }

    fn with_model(program: &[u16], model: CycleModel) -> Self {
        let mut machine = Self { core: Core::new(model), bus: TestBus::new() };
        machine.place(PROGRAM, program);
        machine.place(PROGRAM + 2 * program.len() as u32, &[END]);
        machine.set_word(FLASH, STACK);
        machine.set_word(FLASH + 4, PROGRAM | 1);
        machine.core.reset(&mut machine.bus).expect("the vector table is there");
        machine
    }

    /// A machine with the floating-point unit accessible.
    fn with_float(program: &[u16]) -> Self {
        let mut machine = Self::new(program);
        machine.system_write(0xE000_ED88, 0x00F0_0000);
        machine
    }

    fn place(&mut self, address: u32, halfwords: &[u16]) {
        for (halfword, address) in halfwords.iter().zip((address..).step_by(2)) {
            let bytes = self.bus.bytes(address, Width::Half).expect("memory");
            bytes.copy_from_slice(&halfword.to_le_bytes());
        }
    }

    /// Places a handler at an address and its vector into the table.
    fn handler(&mut self, exception: u32, address: u32, halfwords: &[u16]) {
        self.place(address, halfwords);
        self.set_word(FLASH + 4 * exception, address | 1);
    }

    fn set_word(&mut self, address: u32, value: u32) {
        let bytes = self.bus.bytes(address, Width::Word).expect("memory");
        bytes.copy_from_slice(&value.to_le_bytes());
    }

    fn word(&mut self, address: u32) -> u32 {
        self.bus.read(address, Width::Word).expect("memory")
    }

    fn system_write(&mut self, address: u32, value: u32) {
        assert!(self.bus.system.write(address, Width::Word, value), "{address:#x}");
    }

    fn system_read(&mut self, address: u32) -> u32 {
        self.bus.system.read(address).expect("a register")
    }

    /// Configurable fault status register.
    fn cfsr(&mut self) -> u32 {
        self.system_read(0xE000_ED28)
    }

    /// Core register 0 to 15; 15 is the address of the next instruction.
    fn r(&self, number: usize) -> u32 {
        if number == 15 { self.core.pc() } else { self.core.state.r[number] }
    }

    fn set_r(&mut self, number: usize, value: u32) {
        self.core.state.r[number] = value;
    }

    fn s(&self, number: usize) -> u32 {
        self.core.state.s[number]
    }

    fn set_s(&mut self, number: usize, bits: u32) {
        self.core.state.s[number] = bits;
    }

    /// Makes an interrupt pending by a pulse on its line.
    fn interrupt(&mut self, irq: usize) {
        self.bus.system.set_line(irq, true);
        self.bus.system.set_line(irq, false);
    }

    fn flags(&self) -> u32 {
        self.core.state.apsr & (N | Z | C | V | Q)
    }

    /// Runs to a stop.
    fn run(&mut self) -> Stop {
        self.core.run(&mut self.bus).expect_err("only a stop ends the program")
    }

    /// Runs to the BKPT 0 that ends a program.
    fn finish(&mut self) {
        let stop = self.run();
        assert!(matches!(stop, Stop::Breakpoint { immediate: 0, .. }), "{stop}");
    }

    /// Executes instructions, each after taking a pending exception; ignores [`Bus::event_due`].
    fn step(&mut self, count: usize) {
        for _ in 0..count {
            self.core.drop_modified_code(&mut self.bus);
            assert_eq!(self.core.check_state(&mut self.bus), Ok(None));
            let next = self.core.execute_at(&mut self.bus, self.core.state.pc);
            self.core.state.pc = next.expect("an instruction");
            self.bus.system.synchronise(self.core.state.cycles);
        }
    }

    /// Runs until the core sleeps.
    fn sleep(&mut self) {
        assert_eq!(self.core.run(&mut self.bus), Ok(Pause::Asleep));
    }
}
