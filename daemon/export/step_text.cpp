#include "daemon/export/step_text.h"

#include <Interface_Static.hxx>
#include <Message.hxx>
#include <Message_Messenger.hxx>
#include <Quantity_Color.hxx>
#include <STEPConstruct.hxx>
#include <STEPConstruct_Styles.hxx>
#include <STEPControl_Controller.hxx>
#include <STEPControl_Writer.hxx>
#include <Standard_Version.hxx>
#include <StepBasic_Product.hxx>
#include <StepData_Protocol.hxx>
#include <StepData_StepModel.hxx>
#include <StepData_StepWriter.hxx>
#include <StepRepr_RepresentationContext.hxx>
#include <StepRepr_RepresentationItem.hxx>
#include <StepVisual_Colour.hxx>
#include <StepVisual_MechanicalDesignGeometricPresentationRepresentation.hxx>
#include <StepVisual_PresentationStyleAssignment.hxx>
#include <StepVisual_StyledItem.hxx>
#include <TCollection_HAsciiString.hxx>
#include <Transfer_FinderProcess.hxx>
#include <XSControl_TransferWriter.hxx>
#include <XSControl_WorkSession.hxx>
#include <algorithm>
#include <sstream>
#include <string_view>

#include "daemon/export/step_characters.h"

namespace celadon {
namespace {

/// Stands for the product's name until the text is written: OpenCASCADE would escape the escapes.
constexpr const char* name_marker = "@CELADON-NAME@";

struct Colour {
  double red, green, blue;
};
constexpr Colour measured{0.66, 0.80, 0.72};  ///< the wall: celadon
constexpr Colour assumed{0.95, 0.55, 0.10};   ///< closes the body without having been measured

Handle(TCollection_HAsciiString) ascii(const char* text) {
  return new TCollection_HAsciiString(text);
}

/// Names a face's entity and gives it a colour; false if the transfer left no entity for it.
bool dress(STEPConstruct_Styles& styles, const Handle(Transfer_FinderProcess) & finder, const TopoDS_Face& face,
           const char* name, const Colour& colour) {
  const Handle(StepRepr_RepresentationItem) item = STEPConstruct::FindEntity(finder, face);
  if (item.IsNull()) {
    return false;
  }
  item->SetName(ascii(name));
  const Handle(StepVisual_Colour) encoded =
      STEPConstruct_Styles::EncodeColor(Quantity_Color(colour.red, colour.green, colour.blue, Quantity_TOC_sRGB));
  styles.AddStyle(item, styles.MakeColorPSA(item, encoded, encoded, nullptr, 0.0), nullptr);
  return true;
}

void name_product(const Handle(StepData_StepModel) & model, bool simulated) {
  for (int i = 1; i <= model->NbEntities(); ++i) {
    const auto product = Handle(StepBasic_Product)::DownCast(model->Value(i));
    if (!product.IsNull()) {
      product->SetId(ascii(name_marker));
      product->SetName(ascii(name_marker));
      product->SetDescription(ascii(simulated ? "simulated scan" : "scan"));
    }
  }
}

bool is_measured(const NamedFace& cap, const CadOptions& options) {
  const std::string_view name = cap.name;
  return (name == "bottom" && options.bottom_measured) || (name == "top" && options.top_measured);
}

std::string header(const CadOptions& options, bool assumed_caps) {
  const std::string origin = options.simulated ? "simulated: no real object was scanned" : "scan of a real object";
  std::string text = "ISO-10303-21;\nHEADER;\n";
  text += "FILE_DESCRIPTION(('Celadon: " + origin + "','wall measured" +
          (assumed_caps ? ", discs at the ends assumed" : "") + "'),'2;1');\n";
  text += "FILE_NAME('" + step_string(options.name) + "','" + step_string(options.date) +
          "',(''),(''),'Open CASCADE " OCC_VERSION_COMPLETE "','Celadon','');\n";
  text += options.ap214 ? "FILE_SCHEMA(('AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }'));\n"
                        : "FILE_SCHEMA(('AP242_MANAGED_MODEL_BASED_3D_ENGINEERING_MIM_LF { 1 0 10303 442 1 1 4 }'));\n";
  return text + "ENDSEC;\n";
}

}  // namespace

void prepare_step() {
  // Its messages go to standard output, which belongs to the protocol.
  Message::DefaultMessenger()->ChangePrinters().Clear();
  STEPControl_Controller::Init();
}

tl::expected<std::string, std::string> step_text(const WallBody& body, const CadOptions& options) {
  STEPControl_Writer writer;
  Interface_Static::SetIVal("write.step.schema", options.ap214 ? 4 : 5);
  Interface_Static::SetCVal("write.step.unit", "MM");
  Interface_Static::SetIVal("write.surfacecurve.mode", 1);
  writer.Model(true);
  const auto mode = body.closed ? STEPControl_ManifoldSolidBrep : STEPControl_ShellBasedSurfaceModel;
  if (writer.Transfer(body.shape, mode) != IFSelect_RetDone) {
    return tl::make_unexpected(std::string("OpenCASCADE could not turn the body into STEP entities"));
  }
  const Handle(XSControl_WorkSession) session = writer.WS();
  const Handle(Transfer_FinderProcess) finder = session->TransferWriter()->FinderProcess();
  STEPConstruct_Styles styles(session);
  bool dressed = true;
  for (const NamedFace& wall : body.walls) {
    dressed = dressed && dress(styles, finder, wall.face, wall.name, measured);
  }
  for (const NamedFace& cap : body.caps) {
    const bool known = is_measured(cap, options);
    const std::string name = std::string(cap.name) + (known ? " (measured)" : " (assumed)");
    dressed = dressed && dress(styles, finder, cap.face, name.c_str(), known ? measured : assumed);
  }
  const Handle(StepRepr_RepresentationItem) solid = STEPConstruct::FindEntity(finder, body.shape);
  const Handle(StepRepr_RepresentationContext) context = styles.FindContext(body.shape);
  if (!dressed || solid.IsNull() || context.IsNull()) {
    return tl::make_unexpected(std::string("OpenCASCADE lost track of a face while writing STEP entities"));
  }
  solid->SetName(ascii(name_marker));
  Handle(StepVisual_MechanicalDesignGeometricPresentationRepresentation) presentation;
  styles.CreateMDGPR(context, presentation);
  session->Model()->AddWithRefs(presentation);

  const auto model = Handle(StepData_StepModel)::DownCast(session->Model());
  name_product(model, options.simulated);
  StepData_StepWriter entities(model);
  entities.FloatWriter().SetFormat("%.16E");  // 17 significant digits: every double reads back as itself
  entities.SendModel(Handle(StepData_Protocol)::DownCast(session->Protocol()));
  std::ostringstream text;
  entities.Print(text);
  const std::string printed = std::move(text).str();
  const std::size_t data = printed.find("DATA;");
  if (data == std::string::npos) {
    return tl::make_unexpected(std::string("OpenCASCADE wrote no DATA section"));
  }
  const bool assumed_caps =
      std::any_of(body.caps.begin(), body.caps.end(), [&](const NamedFace& cap) { return !is_measured(cap, options); });
  return header(options, assumed_caps) +
         with_shortest_reals(std::string_view(printed).substr(data), name_marker, step_string(options.name));
}

}  // namespace celadon
