#include "scenes/import/vtk_run.h"

#include <cctype>

#include <fmt/format.h>
#include <vtkCallbackCommand.h>
#include <vtkCommand.h>
#include <vtkExecutive.h>
#include <vtkNew.h>

#include "engine/error.h"

namespace palpate::importer {
namespace {

/// VTK's "ERROR: In FILE, line N\nvtkClass (0x...): what\n\n" to "what".
std::string shortened(const std::string& text) {
  std::string out = text;
  if (out.rfind("ERROR: In ", 0) == 0 || out.rfind("Generic", 0) == 0) {
    const auto colon = out.find("): ");
    const auto line = out.find('\n');
    if (colon != std::string::npos) {
      out.erase(0, colon + 3);
    } else if (line != std::string::npos) {
      out.erase(0, line + 1);
    }
  }
  while (!out.empty() && (std::isspace(static_cast<unsigned char>(out.back())) != 0 ||
                          out.back() == '.' || out.back() == '!')) {
    out.pop_back();
  }
  constexpr std::size_t kLongest = 160;
  if (out.size() > kLongest) out = out.substr(0, kLongest) + " ...";
  return out;
}

struct Listener {
  std::string trouble;
  const Progress* progress = nullptr;
};

void listen(vtkObject* caller, unsigned long event, void* client, void* data) {
  auto& listener = *static_cast<Listener*>(client);
  if (event == vtkCommand::ErrorEvent) {
    if (listener.trouble.empty()) {
      listener.trouble = data == nullptr ? "unknown" : static_cast<const char*>(data);
    }
  } else if (*listener.progress) {
    if (auto* algorithm = vtkAlgorithm::SafeDownCast(caller)) {
      (*listener.progress)(algorithm->GetProgress());
    }
  }
}

}  // namespace

void run(vtkAlgorithm* algorithm, const std::string& what, const Progress& progress,
         const std::string& remedy) {
  Listener listener;
  listener.progress = &progress;
  vtkNew<vtkCallbackCommand> command;
  command->SetClientData(&listener);
  command->SetCallback(listen);
  const unsigned long tags[] = {algorithm->AddObserver(vtkCommand::ErrorEvent, command),
                                algorithm->AddObserver(vtkCommand::ProgressEvent, command)};
  const unsigned long deeper =
      algorithm->GetExecutive()->AddObserver(vtkCommand::ErrorEvent, command);
  algorithm->Update();
  for (const unsigned long tag : tags) algorithm->RemoveObserver(tag);
  algorithm->GetExecutive()->RemoveObserver(deeper);
  if (listener.trouble.empty() && algorithm->GetErrorCode() == 0) return;
  const std::string said = shortened(listener.trouble);
  throw VolumeError(what,
                    said.empty()
                        ? fmt::format("VTK cannot read it (code {})",
                                      static_cast<unsigned long>(algorithm->GetErrorCode()))
                        : fmt::format("VTK cannot read it ({})", said),
                    remedy);
}

}  // namespace palpate::importer
