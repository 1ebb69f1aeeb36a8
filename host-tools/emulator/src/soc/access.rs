//! Loads and stores of the peripherals' registers, and what follows from them elsewhere on the chip.

use super::map::{BLOCK, Block, Entry, base_of};
use super::memory::lanes;
use super::{Soc, context};
use crate::peripherals::Context;
use crate::peripherals::adc::{self, Adc};
use crate::peripherals::clocks::Rcc;
use crate::peripherals::fdcan;
use crate::peripherals::gpio::{Gpio, Mode, Pin};
use crate::peripherals::i2c::I2c;
use crate::peripherals::spi;
use crate::peripherals::syscfg::Syscfg;
use crate::peripherals::timer::Timer;
use crate::peripherals::usart::Usart;
use crate::time::Time;
use crate::violations::Kind;

/// Shortest time from an edge of the rotor sensor's select.
const SELECT: Time = Time::from_ns(350);

impl Soc {
    fn entry(&self, address: u32) -> Option<Entry> {
        let (map, start) = match address {
            0x4000_0000..0x4800_0000 => (&self.map[0], 0x4000_0000),
            0x4800_0000..0x5000_0000 => (&self.map[1], 0x4800_0000),
            0x5000_0000..0x6000_0000 => (&self.map[2], 0x5000_0000),
            _ => return None,
        };
        let place = *map.get(((address - start) / BLOCK) as usize)?;
        let entry = self.entries.get(usize::from(place))?;
        // Comparators and amplifiers are behind SYSCFG, the other controllers' message RAM behind that of the first.
        match (entry.block, address & (BLOCK - 1)) {
            (Block::Syscfg, 0x30..) => None,
            (Block::FdcanRam, offset) if offset as usize / 4 >= fdcan::RAM_WORDS => None,
            _ => Some(*entry),
        }
    }

    /// An access to a peripheral: a store of a value, or a load. None where nothing answers.
    pub(super) fn access(&mut self, address: u32, width: u32, store: Option<u32>) -> Option<u32> {
        self.violations.now = self.now;
        let Some(entry) = self.entry(address) else {
            self.violations.report(Kind::UnmodelledRegister, address & !3, "not emulated");
            return Some(0);
        };
        if let Some([enable, _]) = entry.bits
            && !self.rcc.is_set(enable)
        {
            self.violations.report(Kind::ClockGated, entry.base, "its clock is off");
            return Some(0);
        }
        let value = match store {
            Some(value) => {
                self.store(entry, (address & !3) - entry.base, value, width);
                0
            }
            None => lanes(self.load(entry, (address & !3) - entry.base), address, width),
        };
        self.refresh(entry.block);
        self.plan();
        Some(value)
    }

    fn load(&mut self, entry: Entry, offset: u32) -> u32 {
        let context = context!(self, entry.base);
        match entry.block {
            Block::Adc12 => self.adc.read(offset, context),
            Block::Adc345 => {
                let (converter, offset) = slow_adc(offset);
                match self.slow_adcs.get_mut(converter) {
                    Some(adc) => adc.read(offset, context),
                    None => context.unmodelled(offset),
                }
            }
            Block::Dma(controller) => self.dma.read(controller, offset, context),
            Block::DmaMux => self.dma.read_mux(offset, context),
            Block::Fdcan => self.fdcan.read(offset, context),
            Block::FdcanRam => self.fdcan.read_ram(offset).unwrap_or(0),
            Block::Flash => self.flash.read_register(offset, context),
            Block::Gpio(port) => {
                for (bus, pins) in
                    self.devices.sensor_buses.iter().zip(self.options.wiring.sensor_buses)
                {
                    for (pin, is_released) in pins.into_iter().zip(bus.borrow().released(self.now))
                    {
                        self.gpio[pin.port].drive_externally(pin.number, Some(is_released));
                    }
                }
                self.gpio[port].read(offset, context)
            }
            Block::I2c(number) => {
                let bus = self.devices.sensor_bus(self.buses[number]);
                self.i2c[number].read(offset, self.options.i2c_delay, &*bus.borrow(), context)
            }
            Block::Iwdg => self.iwdg.read(offset, context),
            Block::Pwr => self.pwr.read(offset, context),
            Block::Rcc => {
                let clocks = *self.rcc.clocks();
                let violations = &mut self.violations;
                self.rcc.read(
                    offset,
                    &mut Context { now: self.now, clocks: &clocks, violations, base: entry.base },
                )
            }
            Block::Rng => self.rng.read(offset, context),
            Block::Spi(number) => self.spi[number].read(offset, context),
            Block::Syscfg => self.syscfg.read(offset, context),
            Block::Tim1 => self.tim1.read(offset, context),
            Block::Tim5 => self.tim5.read(offset, context),
            Block::Usart => self.usart.read(offset, context),
        }
    }

    fn store(&mut self, entry: Entry, offset: u32, value: u32, width: u32) {
        if entry.block == Block::Spi(0) && offset == spi::DATA {
            self.check_encoder_edge("the rotor sensor is clocked within 350 ns of its select");
        }
        let functions = &self.functions;
        let has = |pins: &[(Pin, u8)]| {
            pins.iter().all(|(pin, function)| {
                self.gpio[pin.port].mode(pin.number) == Mode::Alternate(*function)
            })
        };
        let context = context!(self, entry.base);
        match entry.block {
            Block::Adc12 => {
                let mut inputs = self.options.wiring.analog.into_iter();
                let has_pins =
                    inputs.all(|pin| self.gpio[pin.port].mode(pin.number) == Mode::Analog);
                self.adc.write(offset, value, has_pins, context);
            }
            Block::Adc345 => {
                let mut inputs = self.options.wiring.thermistors.into_iter();
                let has_pins =
                    inputs.all(|pin| self.gpio[pin.port].mode(pin.number) == Mode::Analog);
                match (slow_adc(offset), &mut self.slow_adcs) {
                    ((_, adc::COMMON_CCR), adcs) => {
                        for adc in adcs {
                            adc.write(adc::COMMON_CCR, value, has_pins, context);
                        }
                    }
                    ((converter, offset), adcs) => match adcs.get_mut(converter) {
                        Some(adc) => adc.write(offset, value, has_pins, context),
                        None => {
                            context.unmodelled_write(offset);
                        }
                    },
                }
            }
            Block::Dma(controller) => {
                self.dma.write(controller, offset, value, context);
                if !self.dma.is_idle() {
                    self.serve_dma();
                    self.refresh(Block::I2c(0));
                    self.refresh(Block::I2c(1));
                    self.refresh(Block::I2c(2));
                    self.refresh(Block::Spi(1));
                    self.refresh(Block::Usart);
                }
            }
            Block::DmaMux => self.dma.write_mux(offset, value, context),
            Block::Fdcan => {
                let has_pins = has(&functions.can);
                let is_sending = self.devices.can.borrow().is_sending();
                self.fdcan.write(offset, value, [has_pins, is_sending], context);
                self.fdcan.check_timing(&*self.devices.can.borrow(), context);
                self.fdcan.offer(&mut *self.devices.can.borrow_mut(), self.now);
            }
            Block::FdcanRam => self.fdcan.write_ram(offset, value, width, context),
            Block::Flash => self.flash.write_register(offset, value, context),
            Block::Gpio(port) => self.store_gpio(port, offset, value, entry.base),
            Block::I2c(number) => {
                let pads =
                    [self.buses[number].is_some(), self.syscfg.fast_mode_plus(number as u32 + 1)];
                self.i2c[number].write(offset, value, pads, self.options.i2c_delay, context);
            }
            Block::Iwdg => {
                if self.iwdg.write(offset, value, context) {
                    self.rcc.start_lsi(self.now);
                }
            }
            Block::Pwr => {
                self.pwr.write(offset, value, context);
                self.update_supply_break();
            }
            Block::Rcc => self.store_rcc(offset, value, entry.base),
            Block::Rng => self.rng.write(offset, value, context),
            Block::Spi(number) => {
                let [.., select] = self.options.wiring.spi(number);
                let is_selected = self.gpio[select.port].driven(select.number) == Some(false);
                let pins = [has(&self.functions.spi[number]), is_selected];
                let clocks = *self.rcc.clocks();
                let bus = if number == 0 { clocks.apb2 } else { clocks.apb1 };
                let cycles = |count| bus.cycles(count);
                self.spi[number].write(offset, value, width, pins, cycles, context);
            }
            Block::Syscfg => {
                self.syscfg.write(offset, value, context);
                self.update_supply_break();
            }
            Block::Tim1 => {
                let has_pins = has(&functions.bridges);
                self.tim1.write(offset, value, has_pins, context);
            }
            Block::Tim5 => self.tim5.write(offset, value, context),
            Block::Usart => {
                let has_pins = has(&functions.serial);
                self.usart.write(offset, value, has_pins, context);
            }
        }
    }

    fn store_rcc(&mut self, offset: u32, value: u32, base: u32) {
        let clocks = *self.rcc.clocks();
        let before: Vec<_> = if Rcc::is_reset_register(offset) {
            self.entries
                .iter()
                .filter(|entry| self.is_held_in_reset(entry))
                .map(|entry| entry.base)
                .collect()
        } else {
            Vec::new()
        };
        let violations = &mut self.violations;
        self.rcc.write(
            offset,
            value,
            &mut Context { now: self.now, clocks: &clocks, violations, base },
        );
        if Rcc::is_reset_register(offset) {
            let held: Vec<_> =
                self.entries.iter().filter(|entry| self.is_held_in_reset(entry)).copied().collect();
            for entry in held.into_iter().filter(|entry| !before.contains(&entry.base)) {
                self.reset_block(entry.block);
            }
        }
        self.update_clocks();
    }

    fn is_held_in_reset(&self, entry: &Entry) -> bool {
        entry.bits.is_some_and(|[_, reset]| self.rcc.is_set(reset))
    }

    fn reset_block(&mut self, block: Block) {
        match block {
            Block::Adc12 => self.adc.reset(),
            Block::Adc345 => self.slow_adcs.iter_mut().for_each(Adc::reset),
            Block::Dma(controller) => self.dma.reset(controller),
            Block::Fdcan => self.fdcan.reset(),
            Block::Gpio(port) => self.gpio[port].reset(port),
            Block::I2c(number) => self.i2c[number] = I2c::new(),
            Block::Rng => self.rng.reset(),
            Block::Spi(number) => self.spi[number].reset(),
            Block::Syscfg => self.syscfg = Syscfg::default(),
            Block::Tim1 => self.tim1.reset(self.now),
            Block::Tim5 => self.tim5 = Timer::new(),
            Block::Usart => self.usart = Usart::new(),
            Block::Pwr => self.pwr.reset(),
            Block::DmaMux | Block::FdcanRam | Block::Flash | Block::Iwdg | Block::Rcc => {}
        }
        self.refresh(block);
        self.update_clocks();
        self.update_connections();
        self.update_supply_break();
    }

    fn store_gpio(&mut self, port: usize, offset: u32, value: u32, base: u32) {
        let wiring = &self.options.wiring;
        let [encoder, inertial] = [0, 1].map(|number| {
            let [.., select] = wiring.spi(number);
            select
        });
        let watched = [encoder, inertial, wiring.sensor_buses[0][0], wiring.sensor_buses[1][0]];
        let levels = |gpio: &[Gpio; 7]| watched.map(|pin| gpio[pin.port].driven(pin.number));
        let before = levels(&self.gpio);
        self.gpio[port].write(offset, value, context!(self, base));
        let after = levels(&self.gpio);
        let [encoder_before, inertial_before, clocks_before @ ..] = before;
        let [encoder_after, inertial_after, clocks_after @ ..] = after;
        for (number, before, after) in
            [(0, encoder_before, encoder_after), (1, inertial_before, inertial_after)]
        {
            if before != after
                && let Some(is_high) = after
            {
                if is_high {
                    self.spi[number].deselect();
                }
                if number == 0 {
                    if !is_high {
                        self.check_encoder_edge(
                            "the rotor sensor's select is high for less than 350 ns",
                        );
                    }
                    self.encoder_edge = self.now;
                }
                self.devices.spi[number].borrow_mut().select(self.now, !is_high);
            }
        }
        for ((bus, before), after) in
            self.devices.sensor_buses.iter().zip(clocks_before).zip(clocks_after)
        {
            // Let go, the clock line rises by its pull-up.
            if before == Some(false) && after != Some(false) {
                bus.borrow_mut().pulse();
            }
        }
        self.update_connections();
    }

    /// The AS5047P needs 350 ns from each edge of its select to what follows (datasheet, table 14: tL, tCSn).
    fn check_encoder_edge(&mut self, detail: &'static str) {
        if self.now.since(self.encoder_edge) < SELECT {
            let address = base_of(&self.entries, Block::Spi(0));
            self.violations.report(Kind::Misconfigured, address, detail);
        }
    }
}

/// Which of ADC3 and ADC5 an offset behind ADC3 belongs to, and the offset in its registers. ADC4 is between them; the
/// common registers are those of both.
const fn slow_adc(offset: u32) -> (usize, u32) {
    match offset {
        0x000..0x100 => (0, offset),
        0x200..0x300 => (1, offset - 0x200),
        0x300.. => (0, offset),
        _ => (usize::MAX, offset),
    }
}
