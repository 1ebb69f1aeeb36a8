//! A running gripper for Foxglove: the topics of an MCAP file, served live over the Foxglove WebSocket protocol.

use std::collections::HashMap;
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::{Context as _, Result};
use axum::body::{Body, Bytes};
use axum::extract::{Request, State};
use axum::http::uri::Authority;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::Response;
use axum::{Extension, Router};
use device_run::channel_map::covariate_values;
use firmware::protocol::messages::Message;
use firmware::protocol::serial::Packet;
use firmware::sensors::hall::SENSORS;
use futures::{SinkExt, StreamExt};
use hyper_util::rt::TokioIo;
use model_export::error::DataError;
use model_export::recordings::columns::COVARIATES;
use model_export::recordings::mcap::{
    EstimatedForce, MESSAGE_ENCODING, NumberTopic, RecordingTopics, SCHEMA_ENCODING, TopicSink,
};
use serde_json::{Value, json};
use sim::campaign::recording::sensor_columns;
use tokio::runtime::Runtime;
use tokio::sync::broadcast::{self, error::RecvError};
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::Message as Sent;
use tokio_tungstenite::tungstenite::handshake::server::create_response_with_body;
use tokio_tungstenite::tungstenite::protocol::{Role, WebSocketConfig};

use crate::board_topics::BoardTopics;
use crate::format::degrees;
use crate::http::{OwnAddress, Place, refuse, serve, single};
use crate::state::{FRESH_S, GripperState, SensorState, Timestamped};

/// Largest difference in microseconds between the board's clock, once set, and that of this computer; beyond, it is set again.
const MAX_DRIFT_US: f64 = 50_000.0;

/// Version of Foxglove's protocol: topics with their definitions (<https://github.com/foxglove/ws-protocol>).
const PROTOCOL: &str = "foxglove.sdk.v1";
/// Messages that wait for a slow client; then the oldest are dropped.
const WAITING: usize = 1024;
/// Maximum length of a client's message, and of unsent ones to it, in bytes.
const MAX_MESSAGE: usize = 64 << 10;
const MAX_UNSENT: usize = 1 << 20;
/// Pages that may connect, besides those of this machine: Foxglove's, in a browser and installed.
const ORIGINS: [&str; 3] = ["https://app.foxglove.dev", "app.foxglove.dev", "file://"];

/// A server of the state of one gripper.
pub struct FoxgloveServer {
    /// Serves until it is dropped.
    _runtime: Runtime,
    port: u16,
    topics: BoardTopics<Channels>,
    /// Start of the reception, in microseconds since 1970.
    begun_us: f64,
    /// What to add to the board's clock for microseconds since 1970.
    offset_us: Option<f64>,
    /// Ticks are received: forces in messages are coarser.
    has_ticks: bool,
}

/// What clients receive.
#[derive(Clone)]
enum News {
    Topic(Value),
    Message { topic: usize, time_ns: u64, data: Bytes },
}

/// The topics of a server, and who may connect.
struct Live {
    information: Value,
    /// Hosts and origins that are accepted too.
    allowed: Vec<String>,
    topics: Mutex<Vec<Value>>,
    news: broadcast::Sender<News>,
}

/// Topics as channels of a server.
pub struct Channels(Arc<Live>);

impl TopicSink for Channels {
    type Id = usize;

    fn add_topic(&mut self, topic: NumberTopic) -> Result<Self::Id, DataError> {
        let mut topics = self.0.topics.lock().unwrap_or_else(PoisonError::into_inner);
        let channel = json!({
            "id": topics.len() + 1, "topic": topic.topic, "encoding": MESSAGE_ENCODING, "schemaName": topic.message,
            "schemaEncoding": SCHEMA_ENCODING, "schema": topic.schema, "metadata": topic.metadata,
        });
        topics.push(channel.clone());
        // Without a client nobody receives it.
        let _ = self.0.news.send(News::Topic(channel));
        Ok(topics.len())
    }

    fn write(
        &mut self,
        topic: &mut Self::Id,
        time_us: f64,
        values: &[f64],
    ) -> Result<(), DataError> {
        if self.0.news.receiver_count() > 0 {
            let time_ns = (1e3 * time_us).round().max(0.0) as u64;
            let data = NumberTopic::encode(values).into();
            let _ = self.0.news.send(News::Message { topic: *topic, time_ns, data });
        }
        Ok(())
    }
}

impl Live {
    /// Whether a request comes from a page that may read the gripper. Any page can connect to this machine; one whose own name
    /// leads here even counts as of this server, but for the name.
    fn admits(&self, headers: &HeaderMap, own: IpAddr) -> bool {
        let is_allowed = |name: &str| self.allowed.iter().any(|one| one.eq_ignore_ascii_case(name));
        let host = single(headers, &header::HOST).and_then(name_of);
        let is_own = |ip: IpAddr| ip.is_loopback() || ip == own.to_canonical();
        let is_host = host.is_some_and(|host| is_allowed(&host) || is_machine(&host, is_own));
        let mut origins = headers.get_all(header::ORIGIN).iter();
        is_host
            && origins.all(|origin| {
                let Ok(origin) = origin.to_str() else { return false };
                let page = origin.strip_prefix("http://").or(origin.strip_prefix("https://"));
                let is_of_machine = |page: String| is_machine(&page, |ip| ip.is_loopback());
                ORIGINS.contains(&origin)
                    || is_allowed(origin)
                    || page.and_then(name_of).is_some_and(is_of_machine)
            })
    }
}

/// Name or address in `NAME:PORT`.
fn name_of(text: &str) -> Option<String> {
    let authority: Authority = text.parse().ok().filter(|_| !text.contains('@'))?;
    Some(authority.host().trim_start_matches('[').trim_end_matches(']').to_owned())
}

fn is_machine(name: &str, is_own: impl Fn(IpAddr) -> bool) -> bool {
    let ip = name.parse::<IpAddr>().map(|ip| ip.to_canonical());
    name.eq_ignore_ascii_case("localhost") || ip.is_ok_and(is_own)
}

/// Connects a client.
async fn connect(
    State(live): State<Arc<Live>>,
    Extension(OwnAddress(own)): Extension<OwnAddress>,
    Extension(place): Extension<Arc<Place>>,
    mut request: Request,
) -> Response {
    if !live.admits(request.headers(), own) {
        return refuse(
            StatusCode::FORBIDDEN,
            "This server answers Foxglove and pages of this machine only; --foxglove-allow admits other hosts and origins.\n",
        );
    }
    let offered = request.headers().get_all(header::SEC_WEBSOCKET_PROTOCOL).iter();
    let mut offered =
        offered.filter_map(|value| value.to_str().ok()).flat_map(|all| all.split(','));
    let has_protocol = offered.any(|one| one.trim() == PROTOCOL);
    let upgrade = hyper::upgrade::on(&mut request);
    let response = create_response_with_body(&request, Body::empty);
    let Ok(mut response) =
        response.map_err(drop).and_then(|it| has_protocol.then_some(it).ok_or(()))
    else {
        return refuse(
            StatusCode::BAD_REQUEST,
            "This is a WebSocket server with the protocol foxglove.sdk.v1: open its address in Foxglove.\n",
        );
    };
    place.admit();
    let protocol = HeaderValue::from_static(PROTOCOL);
    response.headers_mut().insert(header::SEC_WEBSOCKET_PROTOCOL, protocol);
    tokio::spawn(async move {
        let config = WebSocketConfig::default()
            .max_message_size(Some(MAX_MESSAGE))
            .max_frame_size(Some(MAX_MESSAGE))
            .max_write_buffer_size(MAX_UNSENT);
        if let Ok(stream) = upgrade.await {
            let io = TokioIo::new(stream);
            let socket = WebSocketStream::from_raw_socket(io, Role::Server, Some(config)).await;
            // Who disconnects is no error.
            let _ = inform(socket, &live).await;
        }
        drop(place);
    });
    response
}

type Socket = WebSocketStream<TokioIo<hyper::upgrade::Upgraded>>;

/// Tells a client what is new on its topics, until it leaves.
async fn inform(mut socket: Socket, live: &Live) -> Result<()> {
    let advertise =
        |topics: Value| Sent::text(json!({ "op": "advertise", "channels": topics }).to_string());
    let (topics, mut news) = {
        let topics = live.topics.lock().unwrap_or_else(PoisonError::into_inner);
        (topics.clone(), live.news.subscribe())
    };
    let mut count = topics.len();
    socket.send(Sent::text(live.information.to_string())).await?;
    socket.send(advertise(topics.into())).await?;
    // The client's numbers of the topics.
    let mut subscriptions = HashMap::new();
    loop {
        tokio::select! {
            message = socket.next() => match message.transpose()? {
                Some(Sent::Text(text)) => subscribe(&mut subscriptions, count, &text),
                Some(Sent::Close(_)) | None => return Ok(()),
                Some(_) => {}
            },
            news = news.recv() => match news {
                Ok(News::Topic(topic)) => {
                    count += 1;
                    socket.send(advertise(json!([topic]))).await?;
                }
                Ok(News::Message { topic, time_ns, data }) => {
                    let Some(number) = subscriptions.get(&topic) else { continue };
                    let head = [&[1][..], &u32::to_le_bytes(*number), &time_ns.to_le_bytes()];
                    socket.send(Sent::binary([&head.concat()[..], &data].concat())).await?;
                }
                Err(RecvError::Lagged(_)) => {}
                Err(RecvError::Closed) => return Ok(socket.close(None).await?),
            },
        }
    }
}

/// Follows a request of a client; what is not one of a reader is ignored.
fn subscribe(subscriptions: &mut HashMap<usize, u32>, topics: usize, text: &str) {
    let Ok(request) = serde_json::from_str::<Value>(text) else { return };
    let number = |value: &Value| value.as_u64().and_then(|number| u32::try_from(number).ok());
    let list = |name: &str| request[name].as_array().cloned().unwrap_or_default();
    for one in list("subscriptions") {
        let topic = one["channelId"].as_u64().map(|topic| topic as usize);
        if let (Some(topic), Some(id)) =
            (topic.filter(|topic| (1..=topics).contains(topic)), number(&one["id"]))
        {
            subscriptions.insert(topic, id);
        }
    }
    let ended: Vec<u32> = list("subscriptionIds").iter().filter_map(number).collect();
    subscriptions.retain(|_, number| !ended.contains(number));
}

impl FoxgloveServer {
    /// Starts to serve the gripper called `name` at `address`, also under the hosts and to the origins `allowed`.
    ///
    /// # Errors
    /// The address is in use or not of this computer.
    pub fn start(name: &str, address: SocketAddr, allowed: &[String]) -> Result<Self> {
        let runtime =
            tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build();
        let runtime = runtime.context("the server cannot be started")?;
        let unusable = || format!("{address} cannot be served: choose another port");
        let listener = TcpListener::bind(address).with_context(unusable)?;
        listener.set_nonblocking(true).with_context(unusable)?;
        let port = listener.local_addr()?.port();
        let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let begun_us = 1e6 * since_1970.as_secs_f64();
        // Clients that connect again forget the topics of an earlier server by the session.
        let information = json!({
            "op": "serverInfo", "name": name, "capabilities": [], "sessionId": since_1970.as_millis().to_string(),
            "metadata": { "magpie": env!("CARGO_PKG_VERSION") },
        });
        let (topics, news) = (Mutex::default(), broadcast::Sender::new(WAITING));
        let live = Arc::new(Live { information, allowed: allowed.to_vec(), topics, news });
        let router = Router::new().fallback(connect).with_state(live.clone());
        let listener = {
            let _context = runtime.enter();
            tokio::net::TcpListener::from_std(listener).with_context(unusable)?
        };
        runtime.spawn(serve(listener, router));
        let sensors: Vec<usize> = (0..SENSORS).collect();
        let columns = sensors.iter().flat_map(|sensor| sensor_columns(*sensor as u32));
        let hall: Vec<String> =
            columns.chain(COVARIATES.iter().map(|name| (*name).to_owned())).collect();
        let topics = BoardTopics::new(&hall, &[], &sensors, |columns| {
            Ok(RecordingTopics::new(Channels(live), columns, None, 0.0)?)
        })?;
        Ok(Self { _runtime: runtime, port, topics, begun_us, offset_us: None, has_ticks: false })
    }

    /// Port that is served.
    pub const fn port(&self) -> u16 {
        self.port
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
