//! Tables with a different number in every field.

use core::array;
use std::vec::Vec;

use crate::compensate::map::{self, Covariate, Side};
use crate::compensate::{
    Compensation, MOST, OnField, OnForce, creep, earth_field, fingertip_mass, hard_stop,
    hysteresis, magnet_temperature, motor_leakage, neighbour_magnet, sensor_temperature,
    thermal_gap, viscous_lag,
};
use crate::model::network::{Guard, Head, Input, Network, Source, Target, UnitPair, Weights};
use crate::model::parity::Parity;
use crate::model::table::{AxisScale, CentrePair, Linear, SensorTable};
use crate::units::{Field, Force};

/// Different numbers, one after the other: what is left out or read twice shows.
pub struct Numbers(pub u32);

impl Numbers {
    pub fn next(&mut self) -> i32 {
        self.0 = self.0.wrapping_mul(0x9E37_79B1).wrapping_add(0x7F4A_7C15);
        self.0 as i32
    }

    fn many<const N: usize>(&mut self) -> [i32; N] {
        array::from_fn(|_| self.next())
    }

    fn rows<const N: usize, const M: usize>(&mut self) -> [[i32; N]; M] {
        array::from_fn(|_| self.many())
    }

    fn pair(&mut self) -> [i16; 2] {
        [self.next() as i16, self.next() as i16]
    }

    fn pairs<const N: usize, const M: usize>(&mut self) -> [[[i16; 2]; N]; M] {
        array::from_fn(|_| array::from_fn(|_| self.pair()))
    }
}

pub fn sensor(number: u8) -> SensorTable {
    let mut numbers = Numbers(number.into());
    SensorTable {
        number,
        scale: array::from_fn(|_| AxisScale {
            offset: numbers.next(),
            gain: numbers.next(),
        }),
        limit_counts: numbers.next() as i16,
        linear: Linear {
            bias: numbers.many(),
            slope: numbers.rows(),
        },
        pairs: array::from_fn(|_| CentrePair {
            xy: [numbers.pair(), numbers.pair()],
            z: numbers.pair(),
            weight: [numbers.pair(), numbers.pair()],
        }),
        used_pairs: 50,
        shift: [11, 12],
        parity: Parity {
            axis: 1,
            terms: numbers.many(),
            spread: numbers.next(),
        },
    }
}

/// Every effect on the field, then on the forces, two kinds at a sensor.
pub fn compensations<'a>(
    knots: &'a [[i16; 3]; neighbour_magnet::KNOTS],
    values: &'a [i32],
) -> Vec<Compensation<'a>> {
    let numbers = &mut Numbers(7);
    let side = |covariate| Side {
        covariate,
        from: 3,
        step: 5,
        knots: 2,
    };
    let table = |covariate| map::Table {
        sides: [Some(side(covariate)), None],
        values,
    };
    let maps = [
        table(Covariate::Opening),
        table(Covariate::MotorIq),
        table(Covariate::Acceleration(2)),
    ];
    let field = [
        OnField::SensorTemperature(sensor_temperature::Table {
            offset: numbers.many(),
            gain: 5,
        }),
        OnField::MotorLeakage(motor_leakage::Table {
            per_ma: numbers.rows(),
        }),
        OnField::EarthField(earth_field::Table {
            world: numbers.many(),
            element: numbers.rows(),
        }),
        OnField::NeighbourMagnet(neighbour_magnet::Table { knots }),
        OnField::Map(maps),
        OnField::MagnetTemperature(magnet_temperature::Table {
            without: numbers.many(),
            per_count: 9,
        }),
        OnField::ThermalGap(thermal_gap::Table {
            at: numbers.many(),
            rest: numbers.many(),
            bend: numbers.rows(),
        }),
    ];
    let force = [
        OnForce::ViscousLag(viscous_lag::Table {
            lead: numbers.many(),
            rate: 1,
        }),
        OnForce::Creep(creep::Table {
            share: numbers.rows(),
            rate: numbers.many(),
        }),
        OnForce::HardStop(hard_stop::Table {
            knee: numbers.many(),
            beyond: numbers.rows(),
        }),
        OnForce::Hysteresis(hysteresis::Table {
            sliders: array::from_fn(|_| {
                array::from_fn(|_| hysteresis::Slider {
                    reach: numbers.next(),
                    share: numbers.next(),
                })
            }),
        }),
        OnForce::FingertipMass(fingertip_mass::Table { mass: 8 }),
        OnForce::Map([table(Covariate::MotorAngle), table(Covariate::Temperature)]),
    ];
    (0..4)
        .map(|number: usize| Compensation {
            number: number as u8,
            field: array::from_fn::<_, MOST, _>(|at| field.get(at + 2 * number).copied()),
            force: array::from_fn::<_, MOST, _>(|at| force.get(at + 2 * number).copied()),
        })
        .collect()
}

pub fn network() -> Network<2, 4, 1> {
    let numbers = &mut Numbers(3);
    let input = |source, numbers: &mut Numbers| Input {
        source,
        offset: numbers.next(),
        gain: numbers.next(),
    };
    Network {
        sensors: [2],
        target: Target::Rest,
        inputs: [
            [
                input(Source::Field { sensor: 2, axis: 1 }, numbers),
                input(Source::Ideal { sensor: 2, axis: 0 }, numbers),
            ],
            [input(Source::None, numbers), input(Source::None, numbers)],
        ],
        force: numbers.many(),
        warm_up: 77,
        guards: [Guard {
            departure: numbers.many().map(Field),
            force: numbers.many(),
            split: numbers.many().map(Force),
        }],
        weights: Weights {
            first: array::from_fn(|_| UnitPair {
                bias: numbers.rows(),
                input: array::from_fn(|_| numbers.pairs()),
                state_bias: numbers.many(),
                state: array::from_fn(|_| numbers.pairs()),
            }),
            second: array::from_fn(|_| UnitPair {
                bias: numbers.rows(),
                input: array::from_fn(|_| numbers.pairs()),
                state_bias: numbers.many(),
                state: array::from_fn(|_| numbers.pairs()),
            }),
            heads: [Head {
                bias: numbers.many(),
                weights: numbers.pairs(),
            }],
        },
        check: 0,
    }
    .checked()
}
