//! Frames of a host without the key into the receiver of a gripper whose session another host keeps open.

use analysis::progress;
use anyhow::Result;
use firmware::grip::commands::mode;
use firmware::protocol::authentication::Key;
use firmware::protocol::host_session::{HostSession, needs_owner};
use firmware::protocol::messages::{
    Authentication, Command, Message, ParamRequest, Service, ServiceReply,
};
use firmware::protocol::session::{Session, SessionEvent, op, status};
use firmware::protocol::{DEFAULT_NODE, frame_id};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::results::{Section, markdown_table, seeds_text};
use crate::{DefaultSeeds, Options};

const SEEDS: DefaultSeeds = DefaultSeeds { first: 1, full: 1, quick: 1 };
/// Full and quick: random frames, and crafted requests.
const RANDOM: [u64; 2] = [100_000_000, 100_000];
const CRAFTED: [u64; 2] = [1_000_000, 10_000];
/// Sessions of the honest host whose whole traffic is known before the crafted requests begin, and commands in each.
const KNOWN_SESSIONS: usize = 10;
const KNOWN_COMMANDS: usize = 200;
/// Random frames in a millisecond: the rate of a full bus.
const PER_MS: u64 = 8;
/// Time between two crafted requests in ms: the gripper checks two codes in 10 ms, and those of its owner's counters.
const CRAFT_MS: u64 = 5;
/// Period of the honest host's commands in ms.
const COMMAND_MS: u64 = 50;
/// Line of both hosts.
const CAN: u8 = 0;
const KEY: Key = Key(*b"key of a gripper");

/// A request with its authentication, as on the bus.
type Pair = [Message; 2];

/// A gripper, its honest host, and the traffic of both.
struct Bus {
    gripper: Session,
    host: HostSession,
    now_ms: u64,
    rng: ChaCha8Rng,
    /// Requests of the honest host.
    traffic: Vec<Pair>,
    commands: Counts,
}

/// Messages sent, and how many of them the gripper accepted.
#[derive(Clone, Copy, Debug, Default)]
struct Counts {
    sent: u64,
    accepted: u64,
}

impl Bus {
    fn new(seed: u64) -> Self {
        Self {
            gripper: Session::new(DEFAULT_NODE, KEY, 100),
            host: HostSession::new(DEFAULT_NODE, KEY),
            now_ms: 0,
            rng: ChaCha8Rng::seed_from_u64(seed),
            traffic: Vec::new(),
            commands: Counts::default(),
        }
    }

    /// Sends a message; true if the gripper does what only the owner of a session may request, or opens one.
    fn send(&mut self, message: Message) -> (bool, Option<ServiceReply>) {
        self.send_frame(frame_id(DEFAULT_NODE, message.number()), &message.to_bytes())
    }

    fn send_frame(&mut self, id: u16, bytes: &[u8]) -> (bool, Option<ServiceReply>) {
        let random = self.rng.random();
        match self.gripper.receive(self.now_ms, CAN, (id, bytes), || Some(random)) {
            SessionEvent::Command(_) => (true, None),
            SessionEvent::Other(message) => (needs_owner(&message), None),
            SessionEvent::Reply(Message::ServiceReply(reply)) => {
                let opens = matches!(reply.op, op::ARM | op::OPEN | op::END);
                (opens && reply.status == status::DONE, Some(reply))
            }
            _ => (false, None),
        }
    }

    /// The honest host ends its session and arms again.
    fn arm(&mut self) {
        // The gripper gives a challenge to another host only after a second of silence.
        for message in self.host.open(op::ARM) {
            self.now_ms += 20;
            let (_, reply) = self.send(message);
            let Some(reply) = reply.filter(|reply| reply.status == status::CHALLENGE) else {
                continue;
            };
            let answer = self.host.receive(&reply);
            if let [authentication, request] = answer[..] {
                self.traffic.push([authentication, request]);
            }
            for message in answer {
                let (_, reply) = self.send(message);
                reply.iter().for_each(|reply| {
                    self.host.receive(reply);
                });
            }
        }
    }

    /// The honest host sends a command.
    fn command(&mut self) {
        let position = self.rng.random_range(0..1600);
        let command = Command { mode: mode::MOVE, position, speed: 160, ..Command::default() };
        let Some(pair) = self.host.seal(Message::Command(command)) else { return };
        self.traffic.push(pair);
        self.commands.sent += 1;
        let [authentication, request] = pair;
        self.send(authentication);
        let (is_accepted, _) = self.send(request);
        self.commands.accepted += u64::from(is_accepted);
    }

    /// Time passes; the honest host repeats its command.
    fn advance(&mut self, ms: u64) {
        let before = self.now_ms / COMMAND_MS;
        self.now_ms += ms;
        self.gripper.expire(self.now_ms);
        if self.now_ms / COMMAND_MS != before {
            self.command();
        }
    }

    fn known(&mut self) -> Pair {
        let index = self.rng.random_range(0..self.traffic.len());
        self.traffic[index]
    }

    /// A request that somebody builds who knows all frames on the bus and the protocol, but not the key.
    fn crafted(&mut self) -> Pair {
        let known = self.known();
        let [Message::Authentication(authentication), request] = known else { return known };
        let next = self.latest_counter() + self.rng.random_range(1..4);
        let with = |counter: u32, request: Message| {
            [Message::Authentication(Authentication { counter, ..authentication }), request]
        };
        match self.rng.random_range(0..7) {
            // Replayed as it was: of an earlier session, or of this one.
            0 => known,
            1 => self.traffic[self.traffic.len() - 1 - self.rng.random_range(0..20)],
            // Replayed with a counter that is due.
            2 => with(next, request),
            // A known code for another content.
            3 => {
                let mut bytes = request.to_bytes();
                for _ in 0..self.rng.random_range(1..4) {
                    bytes[self.rng.random_range(0..bytes.len())] ^=
                        1 << self.rng.random_range(0..8);
                }
                let changed = Message::from_frame(request.number(), &bytes);
                with(authentication.counter, changed.unwrap_or(request))
            }
            // Codes add up, as those of a checksum would.
            4 => {
                let (second, third) = (self.known(), self.known());
                let tags = [&known, &second, &third].map(|pair| match pair[0] {
                    Message::Authentication(Authentication { tag_low, tag_high, .. }) => {
                        (tag_low, tag_high)
                    }
                    _ => (0, 0),
                });
                let low = tags.iter().fold(0, |sum, tag| sum ^ tag.0);
                let high = tags.iter().fold(0, |sum, tag| sum ^ tag.1);
                let mut bytes = [0; 8];
                for pair in [&known, &second, &third] {
                    bytes.iter_mut().zip(pair[1].to_bytes()).for_each(|(sum, byte)| *sum ^= byte);
                }
                let summed = Message::from_frame(request.number(), &bytes);
                let code = Authentication { counter: next, tag_low: low, tag_high: high };
                [Message::Authentication(code), summed.unwrap_or(request)]
            }
            // A known code for another request.
            5 => {
                let requests = [
                    Message::Service(Service { op: op::MEASURE, argument: 0 }),
                    Message::Service(Service { op: op::ARM, argument: 0 }),
                    Message::Service(Service { op: op::SAVE, argument: 0 }),
                    Message::ParamRequest(ParamRequest { op: 1, id: 2, ..ParamRequest::default() }),
                    Message::Command(Command { mode: mode::GRIP, ..Command::default() }),
                ];
                with(next, requests[self.rng.random_range(0..requests.len())])
            }
            // A guess.
            _ => {
                let (tag_low, tag_high) = (self.rng.random(), self.rng.random());
                let code = Authentication { counter: next, tag_low, tag_high };
                [Message::Authentication(code), request]
            }
        }
    }

    fn latest_counter(&self) -> u32 {
        match self.traffic.last() {
            Some([Message::Authentication(authentication), _]) => authentication.counter,
            _ => 0,
        }
    }
}

/// Counts the frames that a gripper accepts.
pub fn evaluate(options: &Options) -> Result<Section> {
    let seeds = options.seeds(SEEDS);
    let [crafted, random] = [CRAFTED, RANDOM].map(|counts| counts[usize::from(options.quick)]);
    let mut rows = Vec::new();
    let mut is_met = true;
    for seed in seeds.clone() {
        let mut bus = Bus::new(seed);
        for _ in 0..KNOWN_SESSIONS {
            bus.arm();
            (0..KNOWN_COMMANDS).for_each(|_| bus.advance(COMMAND_MS));
        }
        for (kind, count) in [("crafted requests", crafted), ("random frames", random)] {
            bus.commands = Counts::default();
            let checked = bus.gripper.dropped().unauthenticated;
            let accepted = match kind {
                "random frames" => send_random(&mut bus, count),
                _ => send_crafted(&mut bus, count),
            };
            let rejected = bus.gripper.dropped().unauthenticated - checked;
            let honest = bus.commands;
            // A guessed counter may be the one that is due: at most one in 8192 of the authentications, 4 in a millisecond,
            // between two commands.
            let least = if kind == "random frames" { honest.sent * 95 / 100 } else { honest.sent };
            is_met &= accepted == 0 && honest.sent > 0 && honest.accepted >= least;
            rows.push([
                seed.to_string(),
                kind.to_owned(),
                count.to_string(),
                rejected.to_string(),
                accepted.to_string(),
                format!("{} of {}", honest.accepted, honest.sent),
            ]);
        }
    }
    Ok(Section {
        id: "forged-frames",
        title: "Forged frames",
        extent: format!("{}, {crafted} requests and {random} frames each", seeds_text(&seeds)),
        conditions: format!(
            "A host without the key knows the whole traffic of {KNOWN_SESSIONS} sessions and of the present one, which \
             another host keeps open. Crafted requests, each with a code: replayed, with a counter that is due, with changed \
             content, as sums of known ones, for other requests, guessed. Random frames are authentications before commands, services or any bytes with the node's identifiers, and \
             come {PER_MS} in a millisecond, as on a full bus. Specified: none is accepted; all commands of the owner are among \
             crafted requests, and 95 % among random frames."
        ),
        tables: markdown_table(
            [
                "seed",
                "kind",
                "sent",
                "rejected for their code",
                "accepted",
                "owner's commands accepted",
            ],
            rows,
        ),
        is_met: Some(is_met),
    })
}

/// Returns how many of `count` crafted requests are accepted.
fn send_crafted(bus: &mut Bus, count: u64) -> u64 {
    let bar = progress::progress_bar("crafted requests", count as usize);
    let mut accepted = 0;
    for number in 0..count {
        // Now and then the session ends and another begins.
        if number % 10_000 == 0 {
            bus.arm();
        }
        bus.advance(CRAFT_MS);
        for message in bus.crafted() {
            accepted += u64::from(bus.send(message).0);
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    accepted
}

/// Returns how many of `count` random frames are accepted: authentications, each before a command, a service or any frame.
fn send_random(bus: &mut Bus, count: u64) -> u64 {
    const STEP: u64 = 100_000;
    let bar = progress::progress_bar("random frames", count as usize);
    let mut accepted = 0;
    bus.arm();
    for number in 0..count {
        if number % PER_MS == 0 {
            bus.advance(1);
        }
        accepted += u64::from(if number % 2 == 0 {
            let (counter, tag_low) = (bus.rng.random_range(0..1 << 24), bus.rng.random());
            let tag_high = bus.rng.random();
            bus.send(Message::Authentication(Authentication { counter, tag_low, tag_high })).0
        } else {
            let (position, speed) = (bus.rng.random_range(0..1600), bus.rng.random());
            match bus.rng.random_range(0..4) {
                0 => {
                    bus.send(Message::Command(Command {
                        mode: mode::MOVE,
                        position,
                        speed,
                        ..Command::default()
                    }))
                    .0
                }
                1 => {
                    let (op, argument) = (bus.rng.random_range(0..16), bus.rng.random());
                    bus.send(Message::Service(Service { op, argument })).0
                }
                _ => {
                    let mut bytes = [0; 8];
                    bus.rng.fill_bytes(&mut bytes);
                    let number = bus.rng.random_range(0..32);
                    bus.send_frame(frame_id(DEFAULT_NODE, number), &bytes).0
                }
            }
        });
        if number % STEP == 0 {
            bar.inc(STEP);
        }
    }
    bar.finish_and_clear();
    accepted
}
