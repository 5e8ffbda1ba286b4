//! From the AccessKit tree to a flat list of elements, and from one list to the next: pure, so that it can be tested.

use std::collections::{HashMap, HashSet};

use egui::accesskit::{Node, NodeId, Role, Toggled, TreeUpdate};

/// What kind of element stands for a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Element {
    /// Plain text.
    Text,
    /// Something with a role, which may be pressed.
    Box,
    /// A text field.
    TextField,
    /// A slider.
    Range,
    /// A field for a number.
    Number,
}

/// Whether something is on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Checked {
    /// Off.
    No,
    /// On.
    Yes,
    /// Partly.
    Mixed,
}

/// A number and how far it may go.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NumberState {
    /// Now.
    pub value: f64,
    /// Lowest.
    pub min: Option<f64>,
    /// Highest.
    pub max: Option<f64>,
    /// Smallest change.
    pub step: Option<f64>,
}

/// Where a widget can be seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// The part of it that is not clipped away, points.
    pub rect: egui::Rect,
    /// How high it lies.
    pub layer: u8,
}

/// One element of the mirror.
#[derive(Clone, Debug, PartialEq)]
pub struct MirrorNode {
    /// Id of the AccessKit node.
    pub id: u64,
    /// What it is made of.
    pub element: Element,
    /// ARIA role; empty for plain text.
    pub role: &'static str,
    /// Accessible name.
    pub name: String,
    /// Text inside: of a label, of a text field, the choice of a combo box.
    pub text: String,
    /// Where it can be pointed at, in points from the canvas' corner: x, y, width, height. `None` if nowhere: then it
    /// is there for screen readers only.
    pub rect: Option<[f32; 4]>,
    /// How high it lies: what pops up lies above what was there before.
    pub layer: u8,
    /// Check boxes, radio buttons, switches, toggle buttons.
    pub checked: Option<Checked>,
    /// Options and tabs.
    pub selected: Option<bool>,
    /// Things that fold.
    pub expanded: Option<bool>,
    /// Sliders, numbers and progress.
    pub number: Option<NumberState>,
    /// Cannot be used now.
    pub disabled: bool,
    /// Takes clicks, values or text.
    pub interactive: bool,
    /// Elements that belong to this one, wherever they stand.
    pub owns: Vec<u64>,
    /// The element that this one opens and closes, while it is open.
    pub controls: Option<u64>,
}

/// A step from one list of elements to the next.
#[derive(Clone, Debug, PartialEq)]
pub enum Change {
    /// Take it away.
    Remove(u64),
    /// Make it, behind `after` (`None`: first).
    Insert {
        /// The new element.
        node: MirrorNode,
        /// Its neighbour before.
        after: Option<u64>,
    },
    /// Put it behind `after` (`None`: first).
    Move {
        /// Which.
        id: u64,
        /// Its neighbour before.
        after: Option<u64>,
    },
    /// Give it these properties.
    Update(MirrorNode),
}

/// The elements as of the last update, in reading order.
#[derive(Clone, Debug, Default)]
pub struct MirrorModel {
    nodes: Vec<MirrorNode>,
    focus: Option<u64>,
}

impl MirrorModel {
    /// The elements, in reading order.
    pub fn nodes(&self) -> &[MirrorNode] {
        &self.nodes
    }

    /// The node that has egui's focus, if it is in the list.
    pub fn focus(&self) -> Option<u64> {
        self.focus
    }

    /// Somebody wrote `text` into an element: where egui has another one at the next update, that one is what changed.
    pub fn written(&mut self, id: u64, text: &str) {
        if let Some(node) = self.nodes.iter_mut().find(|node| node.id == id) {
            text.clone_into(&mut node.text);
        }
    }

    /// Takes over a whole tree (egui sends no partial ones) and tells what changed. `place_of` tells where a widget
    /// can be seen, if that is known.
    pub fn update(&mut self, update: &TreeUpdate, place_of: impl Fn(u64) -> Option<Place>) -> Vec<Change> {
        let nodes = flatten(update, &place_of);
        let changes = diff(&self.nodes, &nodes);
        self.focus = Some(update.focus.0).filter(|focus| nodes.iter().any(|node| node.id == *focus));
        self.nodes = nodes;
        changes
    }
}

/// The steps that make `new` of `old`.
pub fn diff(old: &[MirrorNode], new: &[MirrorNode]) -> Vec<Change> {
    let mut changes = Vec::new();
    let kept: HashMap<u64, &MirrorNode> = new.iter().map(|node| (node.id, node)).collect();
    // A different kind of element cannot be changed in place.
    let before: HashMap<u64, &MirrorNode> = old
        .iter()
        .filter(|node| kept.get(&node.id).is_some_and(|next| next.element == node.element))
        .map(|node| (node.id, node))
        .collect();
    changes
        .extend(old.iter().filter(|node| !before.contains_key(&node.id)).map(|node| Change::Remove(node.id)));

    let mut order: Vec<u64> = old.iter().map(|node| node.id).filter(|id| before.contains_key(id)).collect();
    let mut after = None;
    for (idx, node) in new.iter().enumerate() {
        match before.get(&node.id) {
            None => {
                order.insert(idx, node.id);
                changes.push(Change::Insert { node: node.clone(), after });
            }
            Some(previous) => {
                if order.get(idx) != Some(&node.id) {
                    if let Some(from) = order.iter().position(|id| *id == node.id) {
                        order.remove(from);
                    }
                    order.insert(idx, node.id);
                    changes.push(Change::Move { id: node.id, after });
                }
                if *previous != node {
                    changes.push(Change::Update(node.clone()));
                }
            }
        }
        after = Some(node.id);
    }
    changes
}

fn flatten(update: &TreeUpdate, place_of: &impl Fn(u64) -> Option<Place>) -> Vec<MirrorNode> {
    let by_id: HashMap<NodeId, &Node> = update.nodes.iter().map(|(id, node)| (*id, node)).collect();
    let Some(tree) = &update.tree else { return Vec::new() };
    let mut nodes = Vec::new();
    let mut seen = HashSet::new();
    let mut stack = vec![tree.root];
    while let Some(id) = stack.pop() {
        // A tree with a loop would be a bug of egui; it must not hang the page.
        if !seen.insert(id) {
            continue;
        }
        let Some(node) = by_id.get(&id) else { continue };
        if node.is_hidden() {
            continue;
        }
        if let Some(mirrored) = mirror_node(id, node, &by_id, place_of) {
            nodes.push(mirrored);
        }
        if !matches!(node.role(), Role::Label | Role::TextInput | Role::MultilineTextInput) {
            stack.extend(node.children().iter().rev());
        }
    }
    with_lists(nodes)
}

fn mirror_node(
    id: NodeId,
    node: &Node,
    by_id: &HashMap<NodeId, &Node>,
    place_of: &impl Fn(u64) -> Option<Place>,
) -> Option<MirrorNode> {
    let (element, role) = element_of(node.role())?;
    // What is read as text needs no name beside it; live regions are read out by their text alone.
    let name = if element == Element::Text { String::new() } else { accessible_name(node, by_id) };
    let text = match element {
        Element::Text => node.value().or(node.label()).unwrap_or_default().to_owned(),
        _ => node.value().unwrap_or_default().to_owned(),
    };
    let interactive = !matches!(element, Element::Text) && is_control(node.role());
    if !interactive && name.is_empty() && text.is_empty() {
        return None;
    }
    let place = place_of(id.0);
    let toggled = node.toggled().map(|toggled| match toggled {
        Toggled::False => Checked::No,
        Toggled::True => Checked::Yes,
        Toggled::Mixed => Checked::Mixed,
    });
    let is_choice = matches!(node.role(), Role::ListBoxOption | Role::Tab | Role::MenuListOption);
    let number = node.numeric_value().map(|value| NumberState {
        value,
        min: node.min_numeric_value(),
        max: node.max_numeric_value(),
        step: node.numeric_value_step(),
    });
    Some(MirrorNode {
        id: id.0,
        element,
        role,
        name,
        text,
        rect: rect_of(node, place),
        layer: place.map_or(0, |place| place.layer),
        checked: toggled.filter(|_| !is_choice),
        selected: node.is_selected().or_else(|| toggled.map(|on| on == Checked::Yes)).filter(|_| is_choice),
        expanded: node.is_expanded(),
        number,
        disabled: node.is_disabled(),
        interactive,
        owns: Vec::new(),
        controls: None,
    })
}

/// What the elements of some roles must be part of, and how that is called for those who hear it.
fn container_of(role: &str) -> Option<(&'static str, &'static str)> {
    match role {
        "option" => Some(("listbox", "Choices")),
        "tab" => Some(("tablist", "")),
        "menuitem" | "menuitemcheckbox" | "menuitemradio" => Some(("menu", "Menu")),
        _ => None,
    }
}

/// Distance from an element's id to that of the list that it begins.
const LIST_ID: u64 = 0x9e37_79b9_7f4a_7c15;

/// egui's options and tabs stand in no list, and a list is what makes them count as "2 of 5": one goes before each run
/// of them. A box that is open tells which list that is.
fn with_lists(nodes: Vec<MirrorNode>) -> Vec<MirrorNode> {
    let mut listed: Vec<MirrorNode> = Vec::with_capacity(nodes.len());
    for run in nodes.chunk_by(|a, b| a.role == b.role && a.layer == b.layer) {
        let first = &run[0];
        if let Some((role, name)) = container_of(first.role) {
            listed.push(MirrorNode {
                id: first.id ^ LIST_ID,
                element: Element::Box,
                role,
                name: name.to_owned(),
                text: String::new(),
                rect: None,
                layer: first.layer,
                checked: None,
                selected: None,
                expanded: None,
                number: None,
                disabled: false,
                interactive: false,
                owns: run.iter().map(|node| node.id).collect(),
                controls: None,
            });
        }
        listed.extend(run.iter().cloned());
    }
    let list = listed.iter().rfind(|node| node.role == "listbox").map(|node| node.id);
    for node in listed.iter_mut().filter(|node| node.role == "combobox") {
        let open = node.expanded == Some(true) && list.is_some();
        node.expanded = Some(open);
        node.controls = list.filter(|_| open);
    }
    listed
}

fn accessible_name(node: &Node, by_id: &HashMap<NodeId, &Node>) -> String {
    if let Some(label) = node.label().filter(|label| !label.is_empty()) {
        return label.to_owned();
    }
    let labels: Vec<&str> = node
        .labelled_by()
        .iter()
        .filter_map(|id| by_id.get(id))
        .filter_map(|label| label.label().or(label.value()))
        .collect();
    if labels.is_empty() { node.placeholder().unwrap_or_default().to_owned() } else { labels.join(" ") }
}

fn rect_of(node: &Node, place: Option<Place>) -> Option<[f32; 4]> {
    let bounds = node.bounds()?;
    let bounds = egui::Rect::from_min_max(
        egui::pos2(bounds.x0 as f32, bounds.y0 as f32),
        egui::pos2(bounds.x1 as f32, bounds.y1 as f32),
    );
    let rect = place.map_or(bounds, |place| place.rect.intersect(bounds));
    // Quarters of a point: finer steps would only make work for the browser.
    let round = |value: f32| (value * 4.0).round() / 4.0;
    let all = [rect.min.x, rect.min.y, rect.width(), rect.height()].map(round);
    (all.iter().all(|value| value.is_finite()) && all[2] >= 1.0 && all[3] >= 1.0).then_some(all)
}

/// The element and ARIA role that stand for a role; `None` for what only holds others.
fn element_of(role: Role) -> Option<(Element, &'static str)> {
    let boxed = |role| Some((Element::Box, role));
    match role {
        Role::Label | Role::Paragraph => Some((Element::Text, "")),
        Role::TextInput
        | Role::MultilineTextInput
        | Role::SearchInput
        | Role::PasswordInput
        | Role::EmailInput
        | Role::UrlInput => Some((Element::TextField, "textbox")),
        Role::Slider => Some((Element::Range, "slider")),
        Role::SpinButton | Role::NumberInput => Some((Element::Number, "spinbutton")),
        Role::Button | Role::DefaultButton | Role::DisclosureTriangle | Role::ColorWell => boxed("button"),
        Role::CheckBox => boxed("checkbox"),
        Role::RadioButton => boxed("radio"),
        Role::Switch => boxed("switch"),
        Role::Link => boxed("link"),
        Role::ComboBox | Role::EditableComboBox => boxed("combobox"),
        Role::ListBox | Role::MenuListPopup => boxed("listbox"),
        Role::ListBoxOption | Role::MenuListOption => boxed("option"),
        Role::Menu => boxed("menu"),
        Role::MenuItem => boxed("menuitem"),
        Role::MenuItemCheckBox => boxed("menuitemcheckbox"),
        Role::MenuItemRadio => boxed("menuitemradio"),
        Role::Tab => boxed("tab"),
        Role::TabList => boxed("tablist"),
        Role::TreeItem => boxed("treeitem"),
        Role::ProgressIndicator => boxed("progressbar"),
        Role::Meter => boxed("meter"),
        Role::Image | Role::Canvas | Role::Figure | Role::GraphicsObject | Role::GraphicsSymbol => {
            boxed("img")
        }
        Role::Heading => Some((Element::Text, "heading")),
        Role::Alert | Role::AlertDialog => Some((Element::Text, "alert")),
        Role::Status | Role::Log => Some((Element::Text, "status")),
        Role::Dialog => boxed("dialog"),
        Role::Tooltip => boxed("tooltip"),
        Role::Navigation => boxed("navigation"),
        Role::Main => boxed("main"),
        Role::Table | Role::Grid => boxed("table"),
        Role::Row => boxed("row"),
        Role::Cell | Role::GridCell => boxed("cell"),
        Role::List => boxed("list"),
        Role::ListItem => boxed("listitem"),
        Role::ColumnHeader => boxed("columnheader"),
        Role::RowHeader => boxed("rowheader"),
        Role::Group | Role::RadioGroup | Role::Region | Role::Form | Role::Pane | Role::GenericContainer => {
            boxed("group")
        }
        _ => None,
    }
}

fn is_control(role: Role) -> bool {
    // Splitters resize panels and have no name; egui's own list is right otherwise.
    role != Role::Splitter && egui::accessibility::is_input(role)
}

#[cfg(test)]
mod tests {
    use egui::accesskit::{Rect, TreeId, TreeInfo};
    use proptest::prelude::*;

    use super::*;

    fn tree(children: Vec<(u64, Node)>, focus: u64) -> TreeUpdate {
        let mut root = Node::new(Role::Window);
        root.set_children(children.iter().map(|(id, _)| NodeId(*id)).collect::<Vec<_>>());
        let mut nodes = vec![(NodeId(1), root)];
        nodes.extend(children.into_iter().map(|(id, node)| (NodeId(id), node)));
        TreeUpdate {
            nodes,
            tree: Some(TreeInfo::new(NodeId(1))),
            tree_id: TreeId::ROOT,
            focus: NodeId(focus),
        }
    }

    fn named(role: Role, name: &str) -> Node {
        let mut node = Node::new(role);
        node.set_label(name);
        node.set_bounds(Rect { x0: 10.0, y0: 20.0, x1: 50.0, y1: 52.0 });
        node
    }

    #[test]
    fn button_keeps_its_name_state_and_place() {
        let mut button = named(Role::Button, "Timelines");
        button.set_toggled(Toggled::True);
        button.set_disabled();
        let mut model = MirrorModel::default();
        model.update(&tree(vec![(7, button)], 7), |_| None);
        let node = &model.nodes()[0];
        assert_eq!(
            (node.role, node.name.as_str(), node.checked),
            ("button", "Timelines", Some(Checked::Yes))
        );
        assert_eq!(node.rect, Some([10.0, 20.0, 40.0, 32.0]));
        assert!(node.disabled && node.interactive);
        assert_eq!(model.focus(), Some(7));
    }

    #[test]
    fn unchanged_tree_changes_nothing() {
        let update = tree(vec![(2, named(Role::Button, "a")), (3, named(Role::CheckBox, "b"))], 1);
        let mut model = MirrorModel::default();
        assert_eq!(model.update(&update, |_| None).len(), 2);
        assert!(model.update(&update, |_| None).is_empty());
    }

    #[test]
    fn what_is_scrolled_away_cannot_be_pointed_at() {
        let update = tree(vec![(2, named(Role::Button, "far down"))], 1);
        let mut model = MirrorModel::default();
        model.update(&update, |_| Some(Place { rect: egui::Rect::NOTHING, layer: 0 }));
        assert_eq!(model.nodes()[0].rect, None);
        let half = egui::Rect::from_min_max(egui::pos2(0.0, 0.0), egui::pos2(100.0, 36.0));
        model.update(&update, |_| Some(Place { rect: half, layer: 2 }));
        assert_eq!(model.nodes()[0].rect, Some([10.0, 20.0, 40.0, 16.0]));
        assert_eq!(model.nodes()[0].layer, 2);
    }

    #[test]
    fn options_and_tabs_belong_to_lists() {
        let mut combo = named(Role::ComboBox, "Speed");
        combo.set_expanded(true);
        let update = tree(
            vec![
                (2, named(Role::Tab, "People")),
                (3, named(Role::Tab, "Tokens")),
                (4, combo),
                (5, named(Role::Button, "Play")),
                (6, named(Role::ListBoxOption, "1")),
                (7, named(Role::ListBoxOption, "2")),
            ],
            1,
        );
        let mut model = MirrorModel::default();
        model.update(&update, |_| None);
        let list = |role: &str| model.nodes().iter().find(|node| node.role == role).expect("a list");
        assert_eq!(list("tablist").owns, [2, 3]);
        assert_eq!(list("listbox").owns, [6, 7]);
        let combo = model.nodes().iter().find(|node| node.role == "combobox").expect("the box");
        assert_eq!((combo.expanded, combo.controls), (Some(true), Some(list("listbox").id)));
        assert!(model.update(&update, |_| None).is_empty(), "lists keep their ids");
    }

    #[test]
    fn headings_and_live_regions_are_read_by_their_text() {
        let update = tree(
            vec![
                (2, named(Role::Heading, "Coverage")),
                (3, named(Role::Alert, "CONNECTION LOST")),
                (4, named(Role::Status, "ARMED")),
            ],
            1,
        );
        let mut model = MirrorModel::default();
        model.update(&update, |_| None);
        let read: Vec<_> = model.nodes().iter().map(|node| (node.role, node.text.as_str())).collect();
        assert_eq!(read, [("heading", "Coverage"), ("alert", "CONNECTION LOST"), ("status", "ARMED")]);
        assert!(model.nodes().iter().all(|node| node.element == Element::Text && node.name.is_empty()));
    }

    #[test]
    fn field_is_named_by_its_label() {
        let mut label = Node::new(Role::Label);
        label.set_value("Your name");
        let mut field = Node::new(Role::TextInput);
        field.set_value("Ada");
        field.push_labelled_by(NodeId(2));
        let mut model = MirrorModel::default();
        model.update(&tree(vec![(2, label), (3, field)], 1), |_| None);
        let node = &model.nodes()[1];
        assert_eq!(
            (node.element, node.name.as_str(), node.text.as_str()),
            (Element::TextField, "Your name", "Ada")
        );
    }

    #[test]
    fn containers_without_a_name_leave_no_element() {
        let mut model = MirrorModel::default();
        model.update(&tree(vec![(2, Node::new(Role::GenericContainer))], 1), |_| None);
        assert!(model.nodes().is_empty());
    }

    /// Applies changes as a browser would.
    fn apply(dom: &mut Vec<MirrorNode>, changes: &[Change]) {
        let place = |dom: &[MirrorNode], after: &Option<u64>| match after {
            None => 0,
            Some(id) => 1 + dom.iter().position(|node| node.id == *id).expect("the neighbour exists"),
        };
        for change in changes {
            match change {
                Change::Remove(id) => dom.retain(|node| node.id != *id),
                Change::Insert { node, after } => {
                    assert!(dom.iter().all(|known| known.id != node.id), "inserted twice");
                    dom.insert(place(dom, after), node.clone());
                }
                Change::Move { id, after } => {
                    let from = dom.iter().position(|node| node.id == *id).expect("moves what exists");
                    let node = dom.remove(from);
                    dom.insert(place(dom, after), node);
                }
                Change::Update(node) => {
                    let known =
                        dom.iter_mut().find(|known| known.id == node.id).expect("updates what exists");
                    assert_eq!(known.element, node.element, "an element cannot change its kind");
                    known.clone_from(node);
                }
            }
        }
    }

    fn any_tree() -> impl Strategy<Value = TreeUpdate> {
        let role = prop_oneof![
            Just(Role::Button),
            Just(Role::Label),
            Just(Role::Slider),
            Just(Role::TextInput),
            Just(Role::CheckBox)
        ];
        proptest::collection::btree_map(2_u64..14, (role, "[a-c]{1,2}"), 0..12)
            .prop_flat_map(|nodes| Just(nodes.into_iter().collect::<Vec<_>>()).prop_shuffle())
            .prop_map(|nodes| {
                let children = nodes.into_iter().map(|(id, (role, name))| (id, named(role, &name))).collect();
                tree(children, 1)
            })
    }

    proptest! {
        #[test]
        fn changes_lead_from_any_tree_to_any_other(steps in proptest::collection::vec(any_tree(), 1..5)) {
            let mut model = MirrorModel::default();
            let mut dom = Vec::new();
            for step in steps {
                let changes = model.update(&step, |_| None);
                apply(&mut dom, &changes);
                prop_assert_eq!(&dom[..], model.nodes());
            }
        }
    }
}
