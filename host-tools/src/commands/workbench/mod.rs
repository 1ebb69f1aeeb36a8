//! `magpie workbench`: a page on this machine in which models of a campaign are built and compared.

mod choice;
mod import;
mod live;

use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;

use analysis::diagnose::Diagnosis;
use analysis::workbench::{Interval, Workbench, WorkbenchModel};
use anyhow::{Context, Result, anyhow, bail};
use axum::extract::{Query, Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{Html, IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Json, Router};
use model_export::effects::EffectTerm;
use model_export::fit::FitOptions;
use model_export::inverse::build::{DeviceModel, ModelVariant, build_model};
use model_export::inverse::codegen::tables_source;
use model_export::model_file::{self, ModelFile, TABLES_MARK};
use model_export::output::{Output, Overwrite};
use model_export::recordings::align::Alignment;
use model_export::recordings::campaign::fingerprints;
use model_export::stop::{self, Stop};
use report::html::{diagnosis, workbench as pages};
use report::text::{findings, terminal};
use serde::Deserialize;
use serde_json::{Value, json};

use crate::commands::args::FitArgs;
use crate::commands::connection::{PortArgs, ReferenceArgs, default_virtual_board};
use crate::commands::diagnose::{plan_output, write_plan_file};
use crate::commands::output::check_compensated;
use crate::commands::workbench::choice::Choice;
use crate::commands::workbench::import::{Opened, campaign_of};
use crate::commands::workbench::live::{LiveGripper, RecordRequest};
use device::http::{Place, read_body, refuse, serve, single};
use device::reference::ReferenceSource;

/// Open a page that adds effects and formulas to a model; every number and plot follows.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie workbench tests/data/friction
  cargo magpie workbench run1.csv run2.csv run3.csv    # tables of other loggers: imports them first
  cargo magpie workbench my-campaign --port /dev/ttyACM0    # with the forces of the gripper
  cargo magpie workbench my-campaign --port /dev/ttyACM0 --reference /dev/ttyUSB0 --reference-map load-cell.toml
  cargo magpie workbench tests/data/demo --virtual          # without hardware

It serves the printed address on this machine only, until Ctrl-C. Only who has the address, which \
contains a random token, can use it. The page shows the commands that do the same. Files are written \
relative to this folder and replace earlier results of the same recordings only. After a semicolon a formula has the ranges of
its nonlinear parameters:
own: dz_um = a*sin(2*pi*opening_mm/p); p=2..5")]
pub struct Args {
    /// Folder of recordings (or one recording); or tables or bags of other programs, one for each recording, which the page imports.
    #[arg(required = true, value_name = "CAMPAIGN")]
    paths: Vec<PathBuf>,
    /// TCP port on 127.0.0.1; 0 selects a free one.
    #[arg(long, value_name = "PORT", default_value_t = 0)]
    http_port: u16,
    #[command(flatten)]
    gripper: PortArgs,
    /// Virtual board: the firmware's tasks, whose sensors measure repeated grasps.
    #[arg(long = "virtual", id = "virtual", conflicts_with_all = ["port", "can"])]
    is_virtual: bool,
    // Shown next to the estimates, and part of the recordings.
    #[command(flatten)]
    reference: ReferenceArgs,
    #[command(flatten)]
    fit: FitArgs,
}

/// What an answer may load: nothing.
const CONTENT_POLICY: &str =
    "default-src 'none'; form-action 'none'; base-uri 'none'; frame-ancestors 'none'";
/// What the page may load too, next to the scripts with its number: styles within elements, drawings, answers.
const PAGE_POLICY: &str = "style-src 'unsafe-inline'; img-src data:; connect-src 'self'";
/// Time for which a computation waits for another one.
const PATIENCE: Duration = Duration::from_secs(2);
const BUSY: Conflict = Conflict(
    "another model is being fitted or diagnosed: wait until it is done, or cancel it with \"Cancel\"",
);
const CANCELLED: Conflict = Conflict("cancelled");

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let alignment = args.fit.align.alignment()?;
    let campaign = campaign_of(&args.paths)?.map_or_else(OnceLock::new, OnceLock::from);
    let source =
        if args.is_virtual { Some(default_virtual_board()?) } else { args.gripper.open()? };
    let reference = args.reference.read()?;
    if reference.is_some() && source.is_none() {
        bail!("--reference belongs to a gripper: give --port, --can or --virtual");
    }
    if reference.as_ref().is_some_and(|reference| reference.source == ReferenceSource::Stdin) {
        bail!("recordings open the reference again: give --reference a port or a socket, not -");
    }
    let start = |source| LiveGripper::new(source, args.gripper.clone(), reference);
    let live = source.map(start).transpose()?;
    let token = random()?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .enable_io()
        .enable_time()
        .build();
    let runtime = runtime.context("the server cannot be started")?;
    runtime.block_on(async {
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, args.http_port));
        let listener = tokio::net::TcpListener::bind(address).await;
        let listener =
            listener.with_context(|| format!("port {} cannot be used", args.http_port))?;
        let address = listener.local_addr()?;
        let url = format!("http://{address}/?token={token}");
        if args.fit.json {
            terminal::print(&format!("{}\n", json!({ "url": url })))?;
        } else {
            terminal::print(&format!(
                "Workbench: {url}\nOpen it in a browser of this machine; Ctrl-C ends it.\n"
            ))?;
        }
        let server = Server {
            bench: Arc::default(),
            computing: Arc::default(),
            diagnosis: Arc::default(),
            live: live.map(Arc::new),
            campaign: Arc::new(campaign),
            sources: args.paths.clone().into(),
            alignment,
            options: args.fit.options(),
            token: token.into(),
            host: address.to_string().into(),
        };
        match serve(listener, router(server)).await {}
    })
}

/// A random number that nobody guesses, in hexadecimal digits.
fn random() -> Result<String> {
    let mut bytes = [0; 16];
    getrandom::fill(&mut bytes).context("the system has no random numbers")?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// State of the server.
#[derive(Clone)]
struct Server {
    /// The models; opened by the first request, since the page appears before the base is fitted.
    bench: Arc<Mutex<Option<Arc<Workbench>>>>,
    computing: Arc<Computation>,
    /// The last diagnosis, and the model of which it is.
    diagnosis: Arc<Mutex<Option<(Choice, Diagnosis)>>>,
    live: Option<Arc<LiveGripper>>,
    /// Absent until the tables are imported.
    campaign: Arc<OnceLock<Opened>>,
    sources: Arc<[PathBuf]>,
    alignment: Alignment,
    options: FitOptions,
    token: Arc<str>,
    host: Arc<str>,
}

impl Server {
    fn opened(&self) -> Result<&Opened> {
        self.campaign.get().context("there is no campaign yet: import the tables on the page")
    }
}

fn router(server: Server) -> Router {
    Router::new()
        .route("/", get(page))
        .route("/import", post(import::import))
        .route("/model", post(model))
        .route("/names", post(names))
        .route("/diagnose", post(diagnose))
        .route("/scatter", post(scatter))
        .route("/live", post(live_state))
        .route("/record", post(record))
        .route("/end-recording", post(end_recording))
        .route("/reload", post(reload))
        .route("/cancel", post(cancel))
        .route("/write", post(write))
        .layer(middleware::from_fn(read_body))
        .layer(middleware::from_fn_with_state(server.clone(), authorise))
        .with_state(server)
}

#[derive(Deserialize)]
struct Access {
    #[serde(default)]
    token: String,
}

/// Refuses requests without the token, and those that another page sends under a name of its own for this address.
async fn authorise(
    State(server): State<Server>,
    Query(Access { token }): Query<Access>,
    headers: HeaderMap,
    request: Request,
    next: Next,
) -> Response {
    let of_header = |name| single(&headers, &name).unwrap_or_default();
    let is_page = request.uri().path() == "/";
    let given = if is_page { &token } else { of_header(HeaderName::from_static("x-token")) };
    // Browsers leave out the port of HTTP.
    let host = of_header(header::HOST);
    let is_own = host == &*server.host || server.host.strip_suffix(":80") == Some(host);
    if !is_own || given != &*server.token {
        return refuse(StatusCode::FORBIDDEN, "Use the address that the command printed.\n");
    }
    if let Some(place) = request.extensions().get::<Arc<Place>>() {
        place.admit();
    }
    let mut response = next.run(request).await;
    let headers = response.headers_mut();
    let policy = headers.entry(header::CONTENT_SECURITY_POLICY);
    policy.or_insert(HeaderValue::from_static(CONTENT_POLICY));
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    headers.insert(header::REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    response
}

async fn page(State(server): State<Server>) -> Response {
    let Ok(nonce) = random() else {
        return refuse(StatusCode::INTERNAL_SERVER_ERROR, "The system has no random numbers.\n");
    };
    let policy = format!("{CONTENT_POLICY}; script-src 'nonce-{nonce}'; {PAGE_POLICY}");
    let Some(opened) = server.campaign.get() else {
        let page = tokio::task::spawn_blocking(move || import::page(&server.sources, &nonce)).await;
        return match page {
            Ok(page) => ([(header::CONTENT_SECURITY_POLICY, policy)], Html(page)).into_response(),
            Err(_) => refuse(StatusCode::INTERNAL_SERVER_ERROR, "The tables cannot be shown.\n"),
        };
    };
    let page = pages::page(&opened.campaign.display().to_string(), server.live.is_some(), &nonce);
    ([(header::CONTENT_SECURITY_POLICY, policy)], Html(page)).into_response()
}

async fn live_state(State(server): State<Server>) -> Response {
    with_gripper(server, |live| Ok(live.to_json())).await
}

async fn record(State(server): State<Server>, Json(request): Json<RecordRequest>) -> Response {
    with_gripper(server, move |live| live.record(&request).map(|()| json!({}))).await
}

async fn end_recording(State(server): State<Server>) -> Response {
    with_gripper(server, |live| live.end_recording().map(|()| json!({}))).await
}

/// Answers from the gripper, if one is connected.
async fn with_gripper(
    server: Server,
    work: impl FnOnce(&LiveGripper) -> Result<Value> + Send + 'static,
) -> Response {
    respond(move || {
        let live = server.live.as_ref();
        work(live.context("no gripper is connected: give --port, --can or --virtual")?)
    })
    .await
}

/// Clears all models: recordings were added to the campaign, or removed.
async fn reload(State(server): State<Server>) -> Response {
    respond(move || {
        server.computing.cancel();
        *lock(&server.diagnosis) = None;
        *lock(&server.bench) = None;
        Ok(json!({}))
    })
    .await
}

/// Ends the computation that is under way; its request is answered with an error.
async fn cancel(State(server): State<Server>) -> Response {
    respond(move || Ok(json!({ "cancelled": server.computing.cancel() }))).await
}

/// Locks what no panic leaves half done.
fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Why a computation has no result.
#[derive(Debug)]
struct Conflict(&'static str);

impl std::fmt::Display for Conflict {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.0)
    }
}

impl std::error::Error for Conflict {}

/// The computation that is under way: one at a time, since each uses all processors.
#[derive(Default)]
struct Computation {
    present: Mutex<Option<Stop>>,
    ended: Condvar,
}

impl Computation {
    /// Does some work alone, until `stop` or [`Computation::cancel`].
    fn run<T: Send>(&self, stop: &Stop, work: impl FnOnce() -> Result<T> + Send) -> Result<T> {
        let waited = self.ended.wait_timeout_while(lock(&self.present), PATIENCE, |present| {
            present.is_some() && !stop.is_requested()
        });
        let (mut present, _) = waited.unwrap_or_else(PoisonError::into_inner);
        if present.is_some() {
            return Err(BUSY.into());
        }
        *present = Some(stop.clone());
        drop(present);
        // Also after a panic.
        let _turn = Turn(self);
        stop.run(work)?.unwrap_or_else(|| Err(CANCELLED.into()))
    }

    /// Requests the end of the work; false if there is none.
    fn cancel(&self) -> bool {
        lock(&self.present).as_ref().inspect(|stop| stop.request()).is_some()
    }
}

struct Turn<'c>(&'c Computation);

impl Drop for Turn<'_> {
    fn drop(&mut self) {
        *lock(&self.0.present) = None;
        self.0.ended.notify_one();
    }
}

/// A request that may have to compute.
struct Job {
    server: Server,
    stop: Stop,
}

impl Job {
    /// The models, opened where that was not done before.
    fn bench(&self) -> Result<Arc<Workbench>> {
        let known = || lock(&self.server.bench).clone();
        let open = || match known() {
            Some(bench) => Ok(bench),
            None => {
                let bench = Arc::new(open(&self.server)?);
                stop::check();
                Ok(lock(&self.server.bench).insert(bench).clone())
            }
        };
        known().map_or_else(|| self.server.computing.run(&self.stop, open), Ok)
    }

    /// A model, fitted where that was not done before.
    fn fit(
        &self,
        bench: &Workbench,
        terms: &[EffectTerm],
        compared: &[EffectTerm],
    ) -> Result<Arc<WorkbenchModel>> {
        let fit = || bench.fit_model(terms, compared);
        let known = bench.fitted(terms, compared);
        known.map_or_else(|| self.server.computing.run(&self.stop, fit), Ok)
    }
}

/// Ends a computation whose client is gone.
struct StopOnDrop(Stop);

impl Drop for StopOnDrop {
    fn drop(&mut self) {
        self.0.request();
    }
}

#[derive(Deserialize)]
struct ModelRequest {
    #[serde(flatten)]
    choice: Choice,
    baseline: Option<Choice>,
}

impl ModelRequest {
    /// Fits the model and the baseline.
    fn fit(
        &self,
        job: &Job,
        bench: &Workbench,
    ) -> Result<(Arc<WorkbenchModel>, Option<Arc<WorkbenchModel>>)> {
        let terms = self.choice.terms(bench)?;
        let baseline = self.baseline.as_ref().map(|choice| choice.terms(bench)).transpose()?;
        let model = job.fit(bench, &terms, baseline.as_deref().unwrap_or_default())?;
        let baseline = baseline.map(|other| job.fit(bench, &other, &terms)).transpose()?;
        Ok((model, baseline))
    }
}

#[derive(Deserialize)]
struct WriteRequest {
    #[serde(flatten)]
    model: ModelRequest,
    kind: Kind,
    path: PathBuf,
}

/// What is written.
#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Kind {
    Model,
    Tables,
    Report,
    Plan,
    Board,
}

async fn model(State(server): State<Server>, Json(request): Json<ModelRequest>) -> Response {
    let (alignment, seed) = (server.alignment, server.options.seed);
    answer(server, move |job, bench| {
        let (shown, baseline) = request.fit(job, bench)?;
        let opened = job.server.opened()?;
        let fit = request.choice.commands(&opened.campaign, bench.base(), alignment, seed);
        let commands: Vec<String> = opened.import.iter().cloned().chain(fit).collect();
        Ok(pages::state(bench, &shown, baseline.as_deref(), &commands))
    })
    .await
}

async fn names(State(server): State<Server>) -> Response {
    answer(server, |_, bench| Ok(pages::formula_names(bench))).await
}

#[derive(Deserialize)]
struct DiagnosisRequest {
    #[serde(flatten)]
    choice: Choice,
    /// Whether to plan the next recording.
    plans: bool,
}

async fn diagnose(State(server): State<Server>, Json(request): Json<DiagnosisRequest>) -> Response {
    let last = server.diagnosis.clone();
    answer(server, move |job, bench| {
        let model = job.fit(bench, &request.choice.terms(bench)?, &[])?;
        let diagnose = || bench.diagnose(&model, request.plans);
        let diagnosis = job.server.computing.run(&job.stop, diagnose)?;
        let answer = pages::diagnosis(&diagnosis);
        *lock(&last) = Some((request.choice, diagnosis));
        Ok(answer)
    })
    .await
}

#[derive(Deserialize)]
struct ScatterRequest {
    // Not flattened: numbers of flattened structures are not read where a dependency enables serde_json's arbitrary precision.
    choice: Choice,
    covariate: String,
    interval: Interval,
}

async fn scatter(State(server): State<Server>, Json(request): Json<ScatterRequest>) -> Response {
    answer(server, move |job, bench| {
        let model = job.fit(bench, &request.choice.terms(bench)?, &[])?;
        let found = bench.scatter(&model, &request.covariate, &request.interval)?;
        Ok(json!({ "plot": pages::scatter(&found) }))
    })
    .await
}

async fn write(State(server): State<Server>, Json(request): Json<WriteRequest>) -> Response {
    let last = lock(&server.diagnosis).clone();
    let live = server.live.clone();
    answer(server, move |job, bench| {
        let campaign = &job.server.opened()?.campaign;
        let (shown, baseline) = request.model.fit(job, bench)?;
        let path = &request.path;
        let message = match request.kind {
            Kind::Model => {
                let inputs = shown.model.file.inputs();
                let output = Output::check(path, model_file::SIGNATURE, inputs, Overwrite::NEVER)?;
                shown.model.file.write_output(&output)?;
                format!("Written to {}.", path.display())
            }
            Kind::Report => {
                let own = last.filter(|(choice, _)| *choice == request.model.choice);
                let sections =
                    own.map_or_else(Vec::new, |(_, of_model)| diagnosis::sections(&of_model));
                let inputs = fingerprints(campaign)?;
                report::html::write(
                    &Output::check(path, report::html::MARK, inputs, Overwrite::NEVER)?,
                    &pages::with_baseline(&shown, baseline.as_deref()),
                    &sections,
                )?;
                let without = if sections.is_empty() {
                    " Without a diagnosis: \"Diagnose\" makes the one of this model."
                } else {
                    ""
                };
                format!("Written to {}.{without}", path.display())
            }
            Kind::Plan => {
                let plan = last.and_then(|(_, diagnosis)| diagnosis.proposal);
                let plan = plan.map(|proposal| proposal.plan).filter(|plan| !plan.steps.is_empty());
                let plan =
                    plan.context("there is no plan yet: \"Plan the next recording\" makes one")?;
                write_plan_file(&plan_output(path, campaign, Overwrite::NEVER)?, &plan, campaign)?
            }
            Kind::Tables => {
                let inputs = shown.model.file.inputs();
                let output = Output::check(path, TABLES_MARK, inputs, Overwrite::NEVER)?;
                let built = tables(&shown.model.file)?;
                check_compensated(&built, "export")?;
                output.write(tables_source(&built).as_bytes())?;
                format!("Written to {}.{}", path.display(), conditions(&built))
            }
            Kind::Board => {
                let live = live.context("no gripper is connected: give --port or --can")?;
                let built = tables(&shown.model.file)?;
                check_compensated(&built, "upload")?;
                live.upload(&built)?.text(false) + &conditions(&built)
            }
        };
        Ok(json!({ "message": message }))
    })
    .await
}

/// Tables of a model, with the hash of its file.
fn tables(model: &ModelFile) -> Result<DeviceModel> {
    let place = Path::new("model.toml");
    let file = model.to_toml(place)?;
    Ok(build_model(model.clone(), place, file.as_bytes(), ModelVariant::Fitted)?)
}

/// When the board compensates the effects of a model, in sentences.
fn conditions(built: &DeviceModel) -> String {
    let conditions = built.conditions.iter();
    let sentence = conditions.map(|(effect, conditions)| {
        format!(" The board compensates {effect} {}.", conditions.join("; "))
    });
    sentence.collect()
}

/// Opens the campaign; setup errors that prevent any result are the error.
fn open(server: &Server) -> Result<Workbench> {
    let opened = Workbench::open(&server.opened()?.campaign, server.alignment, server.options)?;
    opened.map_err(|findings| {
        let stops = findings.iter().filter(|finding| finding.stops);
        let messages =
            stops.map(|finding| format!("{}: {}", finding.place, findings::message(finding)));
        anyhow!("setup errors in the recordings: {}", messages.collect::<Vec<_>>().join("; "))
    })
}

/// Answers from the models.
async fn answer(
    server: Server,
    work: impl FnOnce(&Job, &Workbench) -> Result<Value> + Send + 'static,
) -> Response {
    let job = Job { server, stop: Stop::default() };
    let _stop = StopOnDrop(job.stop.clone());
    respond(move || work(&job, &*job.bench()?)).await
}

/// Runs a request on a thread that may block.
async fn respond(work: impl FnOnce() -> Result<Value> + Send + 'static) -> Response {
    let failed = |status, error: String| (status, Json(json!({ "error": error }))).into_response();
    match tokio::task::spawn_blocking(work).await {
        Ok(Ok(value)) => Json(value).into_response(),
        Ok(Err(error)) if error.is::<Conflict>() => failed(StatusCode::CONFLICT, error.to_string()),
        Ok(Err(error)) => failed(StatusCode::UNPROCESSABLE_ENTITY, format!("{error:#}")),
        Err(_) => failed(
            StatusCode::INTERNAL_SERVER_ERROR,
            "the request ended with an internal error".to_owned(),
        ),
    }
}
