//! State as a terminal user interface.

use firmware::config::constants::{SENSE_RATE, TICK_US};
use firmware::estimator::Validity;
use ratatui::Frame;
use ratatui::layout::{Alignment, Constraint, Layout, Rect};
use ratatui::style::{Color, Style, Stylize};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Axis, Block, Cell, Chart, Dataset, GraphType, Paragraph, Row, Table, Wrap};

use crate::format::{
    GripValues, covariates_line, degrees, fault_line, loss_line, power_line, state_name,
    stranger_line, validity_name,
};
use crate::state::{GripperState, HISTORY_S, SensorState};

/// Reported silence in seconds.
const SILENT_S: f64 = 0.5;
/// Colours of the sensors.
const COLOURS: [Color; 4] = [Color::Cyan, Color::Yellow, Color::Magenta, Color::Green];
/// Minimum range of a plot in newtons.
const LEAST_N: f64 = 5.0;

/// Draws the state; `name` is the source.
pub fn draw(frame: &mut Frame, name: &str, state: &GripperState, now_s: f64) {
    let rows =
        [Constraint::Length(3), Constraint::Length(7), Constraint::Min(7), Constraint::Length(8)];
    let [head, sensors, curves, below] = Layout::vertical(rows).areas(frame.area());
    frame.render_widget(heading(name, state, now_s), head);
    frame.render_widget(table(state, now_s, sensors.width), sensors);
    let halves = [Constraint::Fill(1), Constraint::Fill(1)];
    let [left, right] = Layout::horizontal(halves).areas(curves);
    plot(frame, left, "Fx / N", 0, state, now_s);
    plot(frame, right, "Fz / N", 1, state, now_s);
    let [left, right] = Layout::horizontal(halves).areas(below);
    frame.render_widget(faults(state, now_s), left);
    frame.render_widget(load(state), right);
}

fn heading(name: &str, state: &GripperState, now_s: f64) -> Paragraph<'static> {
    let reception = match state.received_s {
        None => "no message yet".bold().yellow(),
        Some(received_s) if now_s - received_s > SILENT_S => {
            format!("silent for {:.1} s", now_s - received_s).bold().red()
        }
        // Only the serial line carries ticks.
        Some(_) if state.board_us.is_none() => "".into(),
        Some(_) => format!("{} ticks/s", state.ticks_hz).into(),
    };
    let name = name.to_owned().bold();
    let first = Line::from(vec![name, "   ".into(), reception, "   q: quit".dim()]);
    let mut about = match state.version {
        Some(version) => format!(
            "firmware {}.{}.{}, protocol {}.{}, board {}, tables {:04x}",
            version.firmware_major,
            version.firmware_minor,
            version.firmware_patch,
            version.protocol_major,
            version.protocol_minor,
            version.hardware,
            version.tables,
        ),
        None => "version unknown".to_owned(),
    };
    if let Some(board_s) = state.board_s() {
        about += &format!(", {board_s:.0} s since its start");
    }
    if state.heartbeat.is_some_and(|latest| latest.value.command_alive) {
        about += ", commanded";
    }
    let mut about = vec![Span::from(about)];
    if state.is_unprotected() {
        about.push(", unprotected: no key".yellow());
    }
    let grip = state.grip.map_or_else(String::new, |latest| GripValues::of(&latest.value).line());
    let covariates = state.covariates.map_or(grip, |latest| covariates_line(&latest.value));
    Paragraph::new(vec![first, Line::from(about), Line::from(covariates)])
}

/// Columns of the sensors with their widths.
const COLUMNS: [(&str, u16); 9] = [
    ("", 2),
    ("Fx / N", 9),
    ("±", 6),
    ("Fz / N", 9),
    ("±", 6),
    ("", 24),
    ("field / LSB", 20),
    ("°C", 6),
    ("age", 8),
];
/// Columns that a narrow terminal omits, in this order: the forces and their validity stay.
const OMITTED: [usize; 3] = [6, 7, 8];

/// The columns that fit into this width with their spaces and the border.
fn fitting(width: u16) -> Vec<usize> {
    let mut columns: Vec<usize> = (0..COLUMNS.len()).collect();
    for omitted in OMITTED {
        let needed: u16 = columns.iter().map(|column| COLUMNS[*column].1 + 1).sum();
        if needed < width {
            break;
        }
        columns.retain(|column| *column != omitted);
    }
    columns
}

fn table(state: &GripperState, now_s: f64, width: u16) -> Table<'static> {
    let columns = fitting(width);
    let heads = columns
        .iter()
        .map(|column| Cell::from(Line::from(COLUMNS[*column].0).alignment(Alignment::Right)));
    let widths = columns.iter().map(|column| Constraint::Length(COLUMNS[*column].1));
    let sensors = state.sensors.iter().enumerate();
    let rows = sensors.map(|(number, latest)| sensor(number, latest, now_s, &columns));
    Table::new(rows, widths.collect::<Vec<_>>())
        .header(Row::new(heads.collect::<Vec<_>>()).dim())
        .block(Block::bordered().title(" sensors "))
}

fn sensor(number: usize, sensor: &SensorState, now_s: f64, columns: &[usize]) -> Row<'static> {
    let force = |newtons: f64| match sensor.validity {
        Validity::Missing => "-".to_owned(),
        _ => format!("{newtons:.2}"),
    };
    let sigma = |sigma: Option<f64>| sigma.map_or("?".to_owned(), |n| format!("{n:.2}"));
    let (mut words, colour) = match sensor.validity {
        Validity::Valid => (validity_name(sensor.validity).to_owned(), Color::Green),
        Validity::MissingInputs => (validity_name(sensor.validity).to_owned(), Color::Yellow),
        _ => (validity_name(sensor.validity).to_owned(), Color::Red),
    };
    if sensor.disturbed {
        words += ", disturbed";
    }
    let reading = sensor.reading;
    let field = reading.map_or("-".to_owned(), |latest| {
        let [x, y, z] = latest.value.field;
        format!("{x} {y} {z}")
    });
    let temperature = reading
        .map_or("-".to_owned(), |latest| format!("{:.1}", degrees(latest.value.temperature)));
    let age = reading.map_or("-".to_owned(), |latest| age(now_s - latest.at_s));
    let colour = if sensor.disturbed { Color::Yellow } else { colour };
    let cells = [
        (number.to_string(), Style::new().fg(COLOURS[number % COLOURS.len()])),
        (force(sensor.force_n[0]), Style::new().bold()),
        (sigma(sensor.sigma_n[0]), Style::new()),
        (force(sensor.force_n[1]), Style::new().bold()),
        (sigma(sensor.sigma_n[1]), Style::new()),
        (words, Style::new().fg(colour)),
        (field, Style::new()),
        (temperature, Style::new()),
        (age, Style::new()),
    ];
    Row::new(columns.iter().map(|column| {
        let (text, style) = cells[*column].clone();
        Cell::from(Line::from(Span::styled(text, style)).alignment(Alignment::Right))
    }))
}

fn age(seconds: f64) -> String {
    match seconds {
        s if s < 0.1 => "now".to_owned(),
        s if s < 60.0 => format!("{s:.1} s"),
        s => format!("{:.0} min", s / 60.0),
    }
}

fn plot(
    frame: &mut Frame,
    area: Rect,
    title: &str,
    force: usize,
    state: &GripperState,
    now_s: f64,
) {
    let curves: Vec<_> =
        state.sensors.iter().map(|sensor| sensor.history.curve(force, now_s)).collect();
    let points = curves.iter().flatten();
    let greatest_n = points.fold(LEAST_N, |most, (_, newtons)| newtons.abs().max(most));
    let end_n = step_above(greatest_n);
    let sets = curves.iter().zip(COLOURS).map(|(curve, colour)| {
        Dataset::default()
            .marker(Marker::Braille)
            .graph_type(GraphType::Line)
            .style(Style::new().fg(colour))
            .data(curve)
    });
    let labels = |labels: [String; 3]| labels.map(Line::from);
    let chart = Chart::new(sets.collect())
        .block(Block::bordered().title(format!(" {title} ")))
        .x_axis(Axis::default().bounds([-HISTORY_S, 0.0]).labels(labels([
            format!("-{HISTORY_S} s"),
            String::new(),
            "now".to_owned(),
        ])))
        .y_axis(Axis::default().bounds([-end_n, end_n]).labels(labels([
            format!("{:.0}", -end_n),
            "0".to_owned(),
            format!("{end_n:.0}"),
        ])));
    frame.render_widget(chart, area);
}

/// Next value of the series 5, 10, 20, 50, ...
fn step_above(value: f64) -> f64 {
    let decade = 10_f64.powf(value.log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0].map(|step| step * decade);
    steps.into_iter().find(|step| *step >= value).unwrap_or(value)
}

fn faults(state: &GripperState, now_s: f64) -> Paragraph<'static> {
    let lines = state.faults.iter().map(|(place, active)| {
        let since = age(now_s - active.since_s);
        Line::from(format!("{} ({since})", fault_line((place, active)))).red()
    });
    let stopped = state.is_stopped().then(|| Line::from("a stop is latched").red());
    let mut lines: Vec<Line> = stopped.into_iter().chain(lines).collect();
    if let Some(beat) = &state.heartbeat {
        lines.insert(0, Line::from(format!("state: {}", state_name(beat.value.state))));
    }
    if state.faults.is_empty() && !state.is_stopped() {
        lines.push(match state.heartbeat {
            Some(_) => Line::from("no fault").green(),
            None => Line::from("no heartbeat yet").yellow(),
        });
    }
    Paragraph::new(lines)
        .wrap(Wrap { trim: true })
        .block(Block::bordered().title(" state, faults "))
}

fn load(state: &GripperState) -> Paragraph<'static> {
    let mut lines = match state.timing {
        None => vec![Line::from("reported once a second")],
        Some(latest) => vec![
            Line::from(format!("tick {} us of {TICK_US} at the most", latest.value.worst_loop)),
            Line::from(format!("estimate {} us at the most", latest.value.worst_inference)),
            Line::from(format!(
                "{} ticks missed, {} transfers failed",
                latest.value.missed_ticks, latest.value.i2c_errors
            )),
        ],
    };
    lines.extend(state.power.map(|latest| Line::from(power_line(&latest.value))));
    if state.board_us.is_some() {
        let ticks = f64::from(state.ticks_hz) / SENSE_RATE.value;
        lines.push(Line::from(format!("{:.0} % of the ticks arrive here", 100.0 * ticks)));
    }
    lines.push(match loss_line(state) {
        Some(loss_line) => Line::from(format!("lost: {loss_line}")).yellow(),
        None => Line::from("nothing lost"),
    });
    lines.extend(stranger_line(state).map(|stranger| Line::from(stranger).yellow()));
    Paragraph::new(lines).wrap(Wrap { trim: true }).block(Block::bordered().title(" load "))
}

#[cfg(test)]
mod tests;
