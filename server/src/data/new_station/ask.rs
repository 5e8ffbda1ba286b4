//! Asks a person at a terminal where the skin is.

use std::io::{self, BufRead, Write};

use palpate_robot_model::{
    TaxelAxes,
    new_station::{NewPatch, RobotReport},
};

/// What a patch is if the person only presses Enter.
const USUAL: [&str; 3] = ["4x4", "20x15", "+z"];

/// Asks for patches until an empty answer. A wrong answer is asked for again; the end of the input ends the questions.
pub fn ask(
    report: &RobotReport,
    input: &mut dyn BufRead,
    output: &mut dyn Write,
) -> io::Result<Vec<NewPatch>> {
    writeln!(output, "Where is skin? The links of {:?}, tips first:", report.robot)?;
    for (idx, link) in report.links.iter().enumerate() {
        let size = link.size_m.map_or_else(
            || "no shape".to_owned(),
            |size| format!("{:.0} x {:.0} x {:.0} mm", size[0] * 1e3, size[1] * 1e3, size[2] * 1e3),
        );
        let tip = if link.tip { ", a tip" } else { "" };
        writeln!(output, "{:>4}  {} ({size}{tip})", idx + 1, link.link)?;
    }
    let mut patches: Vec<NewPatch> = Vec::new();
    loop {
        let more = if patches.is_empty() { "" } else { ", or Enter if that was all" };
        let Some(answer) = question(input, output, &format!("Link, by name or number{more}: "))? else {
            break;
        };
        if answer.is_empty() {
            if patches.is_empty() {
                writeln!(output, "A station has at least one patch.")?;
                continue;
            }
            break;
        }
        let by_number =
            answer.parse::<usize>().ok().and_then(|number| report.links.get(number.wrapping_sub(1)));
        let by_name = report.links.iter().find(|link| link.link == answer);
        let Some(link) = by_name.or(by_number).map(|link| link.link.as_str()) else {
            writeln!(output, "There is no link {answer:?}.")?;
            continue;
        };
        let id = free_id(link, &patches);
        let questions = [
            format!("Rows x columns of taxels [{}]: ", USUAL[0]),
            format!("Length x width, mm [{}]: ", USUAL[1]),
            format!("Outward in the link's frame, +x -x +y -y +z -z [{}]: ", USUAL[2]),
            format!("Name [{id}]: "),
        ];
        let defaults = [USUAL[0], USUAL[1], USUAL[2], &id];
        let mut answers: Vec<String> = Vec::with_capacity(questions.len());
        for (text, default) in questions.iter().zip(defaults) {
            let Some(answer) = question(input, output, text)? else { return Ok(patches) };
            answers.push(if answer.is_empty() { default.to_owned() } else { answer });
        }
        let [taxels, size, outward, id] = &answers[..] else { continue };
        match format!("{id}={link}:{taxels}@{size}:{outward}").parse::<NewPatch>() {
            Ok(patch) if patches.iter().any(|other| other.id == patch.id) => {
                writeln!(output, "There is a patch {:?} already.", patch.id)?;
            }
            Ok(patch) => patches.push(patch),
            Err(problem) => writeln!(output, "That cannot be: {problem}")?,
        }
    }
    Ok(patches)
}

/// Asks how many numbers a taxel measures and, of several, which is along the outward normal; nothing where the person only
/// presses Enter. A wrong answer is asked for again.
pub fn ask_axes(
    input: &mut dyn BufRead,
    output: &mut dyn Write,
) -> io::Result<(Option<usize>, Option<String>)> {
    let count = loop {
        let text = "Numbers that each taxel measures, 3 for most magnetic skins [1]: ";
        match question(input, output, text)?.as_deref() {
            None | Some("" | "1") => return Ok((None, None)),
            Some("2") => break 2,
            Some("3") => break 3,
            Some(other) => writeln!(output, "{other:?} is none of 1, 2 and 3.")?,
        }
    };
    let names = &TaxelAxes::NAMES[..count];
    loop {
        let text = format!(
            "Which of {} is along the outward normal, with a minus where pressing makes it fall? Enter if nobody knows; the \
             reading is then how far all of them are from rest: ",
            names.join(", ")
        );
        let Some(answer) = question(input, output, &text)?.filter(|answer| !answer.is_empty()) else {
            return Ok((Some(count), None));
        };
        if names.contains(&answer.trim_start_matches('-')) {
            return Ok((Some(count), Some(answer)));
        }
        writeln!(output, "There is no axis {answer:?}.")?;
    }
}

/// An answer without blanks around it; `None` at the end of the input.
fn question(input: &mut dyn BufRead, output: &mut dyn Write, text: &str) -> io::Result<Option<String>> {
    write!(output, "{text}")?;
    output.flush()?;
    let mut line = String::new();
    Ok((input.read_line(&mut line)? > 0).then(|| line.trim().to_owned()))
}

/// The link's name as an id that no patch has yet.
fn free_id(link: &str, patches: &[NewPatch]) -> String {
    let plain: String =
        link.chars().map(|c| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' }).collect();
    let is_free = |id: &String| patches.iter().all(|patch| patch.id != *id);
    let numbered = (2..).map(|number| format!("{plain}_{number}"));
    std::iter::once(plain.clone()).chain(numbered).find(is_free).unwrap_or(plain)
}

#[cfg(test)]
mod tests {
    use palpate_robot_model::{Robot, new_station::explain, simplify_urdf};

    use super::*;

    fn asked(answers: &str) -> (Vec<NewPatch>, String) {
        let urdf = r#"<robot name="r"><link name="palm"/><link name="tip"/>
            <joint name="curl" type="continuous"><parent link="palm"/><child link="tip"/></joint></robot>"#;
        let urdf = simplify_urdf("r", urdf, |_| Err(String::new())).unwrap();
        let report = explain(&Robot::from_urdf("r", &urdf.text, &[]).unwrap(), &urdf);
        let mut output = Vec::new();
        let patches = ask(&report, &mut answers.as_bytes(), &mut output).unwrap();
        (patches, String::from_utf8(output).unwrap())
    }

    #[test]
    fn links_go_by_number_or_name_and_enter_is_the_usual() {
        let (patches, output) = asked("1\n\n\n\n\ntip\n2x3\n10x8\n-y\nside\n\n");
        assert_eq!(
            patches,
            ["tip=tip:4x4@20x15:+z", "side=tip:2x3@10x8:-y"].map(|text| text.parse().unwrap())
        );
        assert!(output.contains("   1  tip (no shape, a tip)\n   2  palm (no shape)"), "{output}");
    }

    #[test]
    fn axes_are_asked_for_until_they_make_sense() {
        let axes = |answers: &str| {
            let mut output = Vec::new();
            let axes = ask_axes(&mut answers.as_bytes(), &mut output).unwrap();
            (axes.0, axes.1, String::from_utf8(output).unwrap())
        };
        for (answers, count, normal) in [
            ("\n", None, None),
            ("1\n", None, None),
            ("3\n\n", Some(3), None),
            ("many\n2\nz\n-y\n", Some(2), Some("-y")),
            ("3\n", Some(3), None),
        ] {
            let (found, axis, output) = axes(answers);
            assert_eq!((found, axis.as_deref()), (count, normal), "{answers:?}: {output}");
        }
        assert!(axes("many\n2\nz\n").2.contains("There is no axis \"z\""));
    }

    #[test]
    fn wrong_answers_are_asked_for_again() {
        let (patches, output) = asked("\n9\nthumb\n1\nmany\n\n\n\n2\n\n\n\n\n2\n\n\n\n\n");
        let ids: Vec<&str> = patches.iter().map(|patch| patch.id.as_str()).collect();
        assert_eq!(ids, ["palm", "palm_2"]);
        for expected in ["at least one patch", "no link \"9\"", "no link \"thumb\"", "\"many\" is no number"]
        {
            assert!(output.contains(expected), "{expected}: {output}");
        }
        assert!(asked("1\n4x4\n").0.is_empty(), "the input ended in the middle of a patch");
    }
}
