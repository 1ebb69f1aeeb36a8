//! A running gripper for Foxglove: the topics of an MCAP file, served live over the Foxglove WebSocket protocol.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::{Context as _, Result};
use device_run::channel_map::covariate_values;
use firmware::protocol::messages::Message;
use firmware::protocol::serial::Packet;
use firmware::sensors::hall::SENSORS;
use foxglove::{
    ChannelBuilder, Context, PartialMetadata, RawChannel, Schema, WebSocketServerHandle,
};
use model_export::recordings::columns::COVARIATES;
use model_export::recordings::error::{DataError, ErrorKind, Location};
use model_export::recordings::mcap::{
    EstimatedForce, MESSAGE_ENCODING, NumberTopic, RecordingTopics, SCHEMA_ENCODING, TopicSink,
};
use sim::campaign::recording::sensor_columns;

use crate::board_topics::BoardTopics;
use crate::format::degrees;
use crate::state::{FRESH_S, GripperState, SensorState, Timestamped};

/// Largest difference in microseconds between the board's clock, once set, and that of this computer; beyond, it is set again.
const MAX_DRIFT_US: f64 = 50_000.0;

/// A server of the state of one gripper.
pub struct FoxgloveServer {
    server: WebSocketServerHandle,
    topics: BoardTopics<Channels>,
    /// Start of the reception, in microseconds since 1970.
    begun_us: f64,
    /// What to add to the board's clock for microseconds since 1970.
    offset_us: Option<f64>,
    /// Ticks are received: forces in messages are coarser.
    has_ticks: bool,
}

/// Topics as channels of a server.
pub struct Channels(Arc<Context>);

impl TopicSink for Channels {
    type Id = Arc<RawChannel>;

    fn add_topic(&mut self, topic: NumberTopic) -> Result<Self::Id, DataError> {
        let schema = Schema::new(topic.message, SCHEMA_ENCODING, topic.schema.into_bytes());
        let channel = ChannelBuilder::new(&topic.topic)
            .context(&self.0)
            .schema(schema)
            .message_encoding(MESSAGE_ENCODING)
            .metadata(topic.metadata)
            .build_raw();
        channel.map_err(|error| {
            let error = std::io::Error::other(error);
            ErrorKind::Unwritable(error).at(Location::file(Path::new(&topic.topic)))
        })
    }

    fn write(
        &mut self,
        topic: &mut Self::Id,
        time_us: f64,
        values: &[f64],
    ) -> Result<(), DataError> {
        let log_time = Some((1e3 * time_us).round().max(0.0) as u64);
        topic.log_with_meta(&NumberTopic::encode(values), PartialMetadata { log_time });
        Ok(())
    }
}

impl FoxgloveServer {
    /// Starts to serve the gripper called `name` at `address`.
    ///
    /// # Errors
    /// The address is in use or not of this computer.
    pub fn start(name: &str, address: SocketAddr) -> Result<Self> {
        let context = Context::new();
        let information =
            HashMap::from([("magpie".to_owned(), env!("CARGO_PKG_VERSION").to_owned())]);
        let server = foxglove::WebSocketServer::new()
            .name(name)
            .context(&context)
            .server_info(information)
            .bind(address.ip().to_string(), address.port())
            .start_blocking()
            .with_context(|| format!("{address} cannot be served: choose another port"))?;
        let sensors: Vec<usize> = (0..SENSORS).collect();
        let columns = sensors.iter().flat_map(|sensor| sensor_columns(*sensor as u32));
        let hall: Vec<String> =
            columns.chain(COVARIATES.iter().map(|name| (*name).to_owned())).collect();
        let topics = BoardTopics::new(&hall, &[], &sensors, |columns| {
            Ok(RecordingTopics::new(Channels(context), columns, None, 0.0)?)
        })?;
        let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let begun_us = 1e6 * since_1970.as_secs_f64();
        Ok(Self { server, topics, begun_us, offset_us: None, has_ticks: false })
    }

    /// Port that is served.
    pub fn port(&self) -> u16 {
        self.server.port()
    }

    /// Publishes a packet, which `state` contains, received `at_s` seconds after the start.
    ///
    /// # Errors
    /// A topic cannot be written.
    pub fn publish(&mut self, at_s: f64, packet: &Packet, state: &GripperState) -> Result<()> {
        let now_us = self.begun_us + 1e6 * at_s;
        match packet {
            Packet::Tick(_) => {
                self.has_ticks = true;
                let time_us = self.board_time_us(now_us, state);
                self.row(time_us, at_s, state)
            }
            Packet::Message { message: Message::Force(_), copy: 0 } if !self.has_ticks => {
                self.row(now_us, at_s, state)
            }
            Packet::Message { message, .. } => self.topics.message(now_us, message),
        }
    }

    /// Time of the last tick: the board's clock, set at the first tick and after a restart.
    fn board_time_us(&mut self, now_us: f64, state: &GripperState) -> f64 {
        let Some(board_us) = state.board_us.map(|time_us| time_us as f64) else { return now_us };
        let offset_us = self.offset_us.get_or_insert(now_us - board_us);
        if (board_us + *offset_us - now_us).abs() > MAX_DRIFT_US {
            *offset_us = now_us - board_us;
        }
        board_us + *offset_us
    }

    fn row(&mut self, time_us: f64, at_s: f64, state: &GripperState) -> Result<()> {
        self.topics.row(time_us, &readings(at_s, state))?;
        let estimate = |sensor: &SensorState| EstimatedForce {
            force_n: sensor.validity.is_in_range().then_some(sensor.force_n),
            sigma_n: Some(sensor.sigma_n.map(|sigma_n| sigma_n.unwrap_or(f64::NAN))),
        };
        let estimates: Vec<EstimatedForce> = state.sensors.iter().map(estimate).collect();
        self.topics.estimates(time_us, &estimates)
    }
}

/// Readings of all sensors and all covariates; NaN for those that the board has not sent within [`FRESH_S`].
fn readings(at_s: f64, state: &GripperState) -> Vec<f64> {
    let readings = state.sensors.iter().flat_map(|sensor| {
        let fresh = sensor.reading.filter(|reading| at_s - reading.at_s <= FRESH_S);
        fresh.map_or([f64::NAN; 4], |Timestamped { value, .. }| {
            let [x, y, z] = value.field.map(f64::from);
            [x, y, z, degrees(value.temperature)]
        })
    });
    let latest = state.covariates.filter(|latest| at_s - latest.at_s <= FRESH_S);
    let covariates = latest.map(|latest| covariate_values(&latest.value)).unwrap_or_default();
    readings.chain(covariates.map(|value| value.unwrap_or(f64::NAN))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware::sensors::hall::HallReading;

    #[test]
    fn a_reading_that_does_not_come_any_more_is_not_repeated() {
        let mut state = GripperState::default();
        let value = HallReading { field: [1, -2, 3], temperature: 0 };
        for (sensor, at_s) in state.sensors.iter_mut().zip([1.0, 1.95]) {
            sensor.reading = Some(Timestamped { value, at_s });
        }
        let numbers = readings(2.0, &state);
        assert_eq!(numbers.len(), 4 * SENSORS + COVARIATES.len());
        assert!(numbers[..4].iter().all(|value| value.is_nan()), "{numbers:?}");
        assert_eq!(numbers[4..7], [1.0, -2.0, 3.0]);
        assert!(numbers[8..].iter().all(|value| value.is_nan()), "{numbers:?}");
    }
}
