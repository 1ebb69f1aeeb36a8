//! Test vectors of the self-test, from a seed: identical on the chip and on a host.

use firmware::model::formats::{
    COORDINATE_LIMIT, CentrePair, EXP_ENTRIES, GruState, Head, Pair, UnitPair, Weights,
};

/// Steps of all networks together.
pub const STEPS: u32 = 8 * 3 * (5 * 800 + 350 + 3 * 200);
/// Evaluations of radial basis functions.
pub const SUMS: u32 = 3 * 51 * 40;

/// An implementation of the kernels under test.
pub trait Machine {
    /// One step of a network with the inputs in `state`.
    fn step<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>(
        &mut self,
        weights: &Weights<INPUTS, HIDDEN, SENSORS>,
        state: &mut GruState<INPUTS, HIDDEN, SENSORS>,
    );
    /// One sum of radial basis functions.
    fn sum(&mut self, exp: &[u32; EXP_ENTRIES], pairs: &[CentrePair], at: [i16; 3]) -> [i32; 2];
}

/// Runs every vector; the digest of all results.
pub fn run(machine: &mut impl Machine) -> u64 {
    let mut random = Random(0x9e37_79b9_7f4a_7c15);
    let mut digest = Digest::default();
    // Two inputs; three; five; the field and the ideal model's forces of one sensor.
    networks::<1, 4, 1>(machine, &mut random, &mut digest, 800);
    networks::<2, 4, 1>(machine, &mut random, &mut digest, 800);
    networks::<3, 4, 1>(machine, &mut random, &mut digest, 800);
    networks::<1, 8, 1>(machine, &mut random, &mut digest, 800);
    networks::<2, 8, 1>(machine, &mut random, &mut digest, 800);
    networks::<6, 16, 1>(machine, &mut random, &mut digest, 350);
    networks::<6, 16, 4>(machine, &mut random, &mut digest, 200);
    // Sizes without a use on the device, for the other paths of the kernel.
    networks::<4, 12, 2>(machine, &mut random, &mut digest, 200);
    networks::<8, 16, 3>(machine, &mut random, &mut digest, 200);
    basis_functions(machine, &mut random, &mut digest);
    digest.0
}

/// Distribution of the weights.
#[derive(Clone, Copy)]
enum Kind {
    /// As in a trained network.
    Nominal,
    /// The same with update gates at 0.98 to 0.998.
    Slow,
    /// Any bits: sums wrap, gates and candidates saturate.
    Extreme,
}

fn networks<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>(
    machine: &mut impl Machine,
    random: &mut Random,
    digest: &mut Digest,
    steps: u32,
) {
    let mut weights = zero_weights();
    for kind in [Kind::Nominal, Kind::Slow, Kind::Extreme] {
        for _ in 0..8 {
            fill(&mut weights, kind, random);
            let mut state = GruState::<INPUTS, HIDDEN, SENSORS>::RESET;
            if let Kind::Extreme = kind {
                state.full = state.full.map(|layer| layer.map(|pair| pair.map(|_| random.word())));
            }
            for count in 0..steps {
                state.input = inputs(random, count);
                machine.step(&weights, &mut state);
                digest.add(state.full.as_flattened().as_flattened());
                digest.add(state.outputs.as_flattened());
            }
        }
    }
}

/// Constant, then random, then at the ends of the range.
pub fn inputs<const INPUTS: usize>(random: &mut Random, count: u32) -> [Pair; INPUTS] {
    [(); INPUTS].map(|()| {
        [(); 2].map(|()| match count / 50 % 4 {
            0 => 12_000,
            1 | 2 => random.half(),
            _ if random.word() < 0 => i16::MIN,
            _ => i16::MAX,
        })
    })
}

/// A network without weights.
pub const fn zero_weights<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>()
-> Weights<INPUTS, HIDDEN, SENSORS> {
    Weights {
        first: [const {
            UnitPair {
                bias: [[0; 3]; 2],
                input: [[[[0; 2]; 3]; 2]; INPUTS],
                state_bias: [0; 2],
                state: [[[[0; 2]; 3]; 2]; HIDDEN],
            }
        }; HIDDEN],
        second: [const {
            UnitPair {
                bias: [[0; 3]; 2],
                input: [[[[0; 2]; 3]; 2]; HIDDEN],
                state_bias: [0; 2],
                state: [[[[0; 2]; 3]; 2]; HIDDEN],
            }
        }; HIDDEN],
        heads: [const { Head { bias: [0; 4], weights: [[[0; 2]; 4]; HIDDEN] } }; SENSORS],
    }
}

fn fill<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>(
    weights: &mut Weights<INPUTS, HIDDEN, SENSORS>,
    kind: Kind,
    random: &mut Random,
) {
    weights.first.iter_mut().for_each(|units| fill_units(units, kind, random));
    weights.second.iter_mut().for_each(|units| fill_units(units, kind, random));
    for head in &mut weights.heads {
        head.bias = head.bias.map(|_| random.within(kind, 27));
        head.weights
            .as_flattened_mut()
            .as_flattened_mut()
            .iter_mut()
            .for_each(|weight| *weight = random.within(kind, 11) as i16);
    }
}

fn fill_units<const INPUTS: usize, const HIDDEN: usize>(
    units: &mut UnitPair<INPUTS, HIDDEN>,
    kind: Kind,
    random: &mut Random,
) {
    for [reset, update, candidate] in &mut units.bias {
        *reset = random.within(kind, 26);
        *update = random.within(kind, 26);
        *candidate = random.within(kind, 26);
        if let Kind::Slow = kind {
            *update += 5 << 26;
        }
    }
    units.state_bias = [(); 2].map(|()| random.within(kind, 26));
    let input = units.input.as_flattened_mut().as_flattened_mut();
    let state = units.state.as_flattened_mut().as_flattened_mut();
    for weight in input.iter_mut().chain(state).flatten() {
        *weight = random.within(kind, 12) as i16;
    }
}

/// Weights as a trained network's, slow, or any bits: `kind` is 0, 1 or 2.
pub fn draw<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>(
    weights: &mut Weights<INPUTS, HIDDEN, SENSORS>,
    kind: u32,
    random: &mut Random,
) {
    let kind = match kind {
        0 => Kind::Nominal,
        1 => Kind::Slow,
        _ => Kind::Extreme,
    };
    fill(weights, kind, random);
}

fn basis_functions(machine: &mut impl Machine, random: &mut Random, digest: &mut Digest) {
    for extreme in [false, false, true] {
        let (exp, pairs) = centres(random, extreme);
        for used in 0..=pairs.len() {
            for _ in 0..40 {
                let at = coordinates(random, extreme);
                digest.add(&machine.sum(&exp, pairs.get(..used).unwrap_or(&[]), at));
            }
        }
    }
}

/// Any table of the exponential, and centres with any weights.
pub fn centres(random: &mut Random, extreme: bool) -> ([u32; EXP_ENTRIES], [CentrePair; 50]) {
    let exp = [(); EXP_ENTRIES].map(|()| random.word() as u32);
    let pairs = [(); 50].map(|()| {
        let ([x1, y1, z1], [x2, y2, z2]) =
            (coordinates(random, extreme), coordinates(random, extreme));
        CentrePair {
            xy: [[x1, y1], [x2, y2]],
            z: [z1, z2],
            weight: [(); 2].map(|()| [(); 2].map(|()| random.half())),
        }
    });
    (exp, pairs)
}

/// Inside the box and at its edges, or any bits.
pub fn coordinates(random: &mut Random, extreme: bool) -> [i16; 3] {
    [(); 3].map(|()| match (extreme, random.half()) {
        (true, any) => any,
        (false, any) if any % 16 == 0 => COORDINATE_LIMIT * any.signum(),
        (false, any) => any % COORDINATE_LIMIT,
    })
}

/// Numbers that look random: xorshift, so that chip and host draw the same.
pub struct Random(pub u64);

impl Random {
    /// Any bits.
    pub fn word(&mut self) -> i32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 32) as i32
    }

    fn half(&mut self) -> i16 {
        self.word() as i16
    }

    /// Within ±2^bits, or any bits in an extreme network.
    fn within(&mut self, kind: Kind, bits: u32) -> i32 {
        match kind {
            Kind::Extreme => self.word(),
            Kind::Nominal | Kind::Slow => self.word() >> (31 - bits),
        }
    }
}

/// FNV-1a over words.
struct Digest(u64);

impl Default for Digest {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Digest {
    fn add(&mut self, words: &[i32]) {
        for &word in words {
            self.0 = (self.0 ^ u64::from(word as u32)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }
}
